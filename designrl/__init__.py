"""Reinforcement Learning for Improving Agent Design (Ha 2018), reproduced with recorded logs."""

import importlib

from designrl import envs  # noqa: F401 (registers the environments)
from designrl.provenance import VERSION

__version__ = VERSION
__all__ = ["evaluate", "load"]


def __getattr__(name: str):
    # Loaded on first use, so that `import designrl` for an environment does not wait for torch.
    if name == "load":
        return importlib.import_module("designrl.names").load
    if name == "evaluate":
        return importlib.import_module("designrl.evaluation").evaluate
    raise AttributeError(f"module 'designrl' has no attribute {name!r}")
