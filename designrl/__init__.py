"""Reinforcement Learning for Improving Agent Design (Ha 2018), reproduced with recorded logs."""

import importlib

import gymnasium

from designrl.provenance import VERSION

__version__ = VERSION
__all__ = ["evaluate", "load"]

# Time limits of the 2018 environments, in steps.
for _name, _entry_point, _kwargs, _steps in (
    ("BipedalWalker-v0", "designrl.envs.walker:Walker", {}, 1600),
    ("BipedalWalkerHardcore-v0", "designrl.envs.walker:Walker", {"hardcore": True}, 2000),
    ("Ant-v0", "designrl.envs.ant:Ant", {}, 1000),
):
    gymnasium.register(
        f"designrl/{_name}",
        entry_point=_entry_point,
        kwargs=_kwargs,
        max_episode_steps=_steps,
    )


def __getattr__(name: str):
    # Loaded on first use, so that `import designrl` for an environment does not wait for torch.
    if name == "load":
        return importlib.import_module("designrl.checkpoint").load
    if name == "evaluate":
        return importlib.import_module("designrl.evaluation").evaluate
    raise AttributeError(f"module 'designrl' has no attribute {name!r}")
