"""Checkpoints: safetensors files with a policy, its body and where they came from.

A file holds one tensor, `parameters` (P,) float64, and one metadata entry, `designrl`, a JSON
object: experiment, network, seed, settings, generation, score, environment steps, versions. One
entry, because safetensors writes several in random order and equal runs must give equal bytes.
Loading one runs no code.
"""

import contextlib
import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from designrl.errors import InputError, printable
from designrl.experiments import Network, get_experiment
from designrl.files import file_hash, read_limited, write_atomically
from designrl.policy import Agent

FORMAT = "designrl checkpoint 1"
STATE_FORMAT = "designrl training state 1"
_WHAT_TO_DO = {
    FORMAT: "get it again, or name another",
    STATE_FORMAT: "put a good copy back, or start again in another folder with --out",
}
MCAP_MAGIC = b"\x89MCAP0\r\n"  # with which a recording begins
MAX_FILE_BYTES = 4 * 2**20  # a checkpoint of ours is under 1 MB; nothing larger is read
MAX_HEADER_BYTES = 2**18  # ours are some 2 kB; text grows twentyfold when it is parsed
MAX_DEPTH = 20  # of values in the metadata; ours is 3


def read_bounded(path: Path) -> bytes:
    """The content of what should be a checkpoint, ours or the author's.

    Raises:
        InputError: missing, a recording, or too large to be one.
    """
    data = read_limited(path, MAX_FILE_BYTES)
    if data.startswith(MCAP_MAGIC):
        raise InputError(
            f"{path} is a recording, not a checkpoint; open it with `designrl info` or "
            "`designrl replay`"
        )
    if len(data) > MAX_FILE_BYTES:
        raise InputError(
            f"{path} has {path.stat().st_size:,} bytes, too many for such a file; name another"
        )
    return data


def read_tensors(path: str | Path, format_name: str) -> tuple[dict[str, np.ndarray], dict]:
    """Tensors and metadata of one of our safetensors files.

    Raises:
        InputError: missing, too large, damaged or not of that format.
    """
    path = Path(path)
    data = read_bounded(path)
    part = "whole " if data[8:9] in (b"", b"{") else ""  # there, any safetensors' header begins
    damaged = f"{path} is not a {part}{format_name} file; {_WHAT_TO_DO[format_name]}"
    header_bytes = int.from_bytes(data[:8], "little")
    if header_bytes > MAX_HEADER_BYTES:
        raise InputError(damaged)
    try:
        tensors = safetensors.numpy.load(data)
        header = json.loads(data[8 : 8 + header_bytes])
        metadata = json.loads(header["__metadata__"]["designrl"])
        if _is_deep(metadata, MAX_DEPTH):
            raise ValueError("what recursion later would not get through")
    except (safetensors.SafetensorError, KeyError, TypeError, ValueError, RecursionError):
        raise InputError(damaged) from None
    found = metadata.get("format") if isinstance(metadata, dict) else None
    if (found, format_name) == (STATE_FORMAT, FORMAT):
        raise InputError(
            f"{path} is a training state, not an agent; name best.safetensors beside it"
        )
    if found != format_name:
        raise InputError(damaged)
    if metadata.pop("sha256", None) != content_hash(tensors, metadata):
        raise InputError(damaged)
    return tensors, metadata


def _is_deep(value, left: int) -> bool:
    """Nested more than so many times."""
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return left == 0 or any(_is_deep(child, left - 1) for child in inside)


def content_hash(tensors: dict[str, np.ndarray], metadata: dict) -> str:
    """What a file's "sha256" says of all else in it."""
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name in sorted(tensors):
        t = tensors[name]
        digest.update(f"{name} {t.dtype.str} {t.shape} ".encode() + t.tobytes())
    return digest.hexdigest()


def write_tensors(
    path: str | Path, tensors: dict[str, np.ndarray], metadata: dict, format_name: str
) -> None:
    """The reverse of `read_tensors`; the same input gives the same bytes."""
    # As it will be read: JSON has no tuples and no numbers as keys.
    metadata = json.loads(json.dumps({"format": format_name, **metadata}))
    text = json.dumps({**metadata, "sha256": content_hash(tensors, metadata)}, sort_keys=True)
    write_atomically(path, safetensors.numpy.save(tensors, metadata={"designrl": text}))


def save(agent: Agent, path: str | Path) -> None:
    """Write an agent as a checkpoint.

    Raises:
        InputError: the file cannot be written, or its experiment's name is not known or another's.
    """
    if get_experiment(agent.experiment.name) != agent.experiment:
        raise InputError(
            f"{path} would be read as another experiment {agent.experiment.name!r}; choose another "
            "name for yours"
        )
    metadata = {
        **agent.metadata,
        "experiment": agent.experiment.name,
        "network": dataclasses.asdict(agent.network),
    }
    if limits := agent.experiment.limits_of(agent.space):
        metadata["limits"] = limits
    write_tensors(path, {"parameters": agent.parameters}, metadata, FORMAT)


def load(path: str | Path, experiment: str | None = None) -> Agent:
    """The agent of a checkpoint.

    Args:
        path: the file (`designrl.names.load` takes names, too).
        experiment: what it must be of, if anything.

    Raises:
        InputError: missing, damaged, of another experiment, or with numbers that are not finite.
    """
    path = Path(path)
    tensors, metadata = read_tensors(path, FORMAT)
    try:
        found = get_experiment(metadata["experiment"])
        network = Network(**{**metadata["network"], "sizes": tuple(metadata["network"]["sizes"])})
        if tensors["parameters"].dtype != np.float64:
            raise InputError("its parameters are not float64")
        space = found.space(metadata.get("limits"))
        agent = Agent(found, tensors["parameters"], network, metadata, space)
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}") from None
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path} lacks some of what a checkpoint holds; get it again") from None
    if experiment is not None and found != get_experiment(experiment):
        raise InputError(f"{path} is of experiment {found.name}, not {experiment}; name that one")
    return agent


def describe(path: str | Path) -> str:
    """What a checkpoint or training state holds and where it came from, as text.

    Raises:
        InputError: as `load`.
    """
    path = Path(path)
    with contextlib.suppress(InputError):  # if it is no state, `load` says what is wrong
        _, state = read_tensors(path, STATE_FORMAT)
        progress = state.get("progress")
        about = progress if isinstance(progress, dict) else {"progress": progress}
        lines = [
            f"{path}: state of a training run of {state.get('experiment')}; "
            "`designrl train ... --resume` goes on with it"
        ]
        about = {**about, "settings": state.get("settings")}
        lines += [f"{key:15}  {value}" for key, value in about.items()]
        return "\n".join(map(printable, lines))
    agent = load(path)
    m = agent.metadata
    lines = [
        f"{path}: checkpoint of {agent.experiment.name} "
        f"({agent.experiment.letter}, {agent.experiment.title})",
        f"sha256       {file_hash(path)}",
        f"network      {agent.network}",
        f"parameters   {len(agent.parameters)}",
    ]
    for key in ("source", "seed", "generation", "score", "score_episodes", "environment_steps"):
        if isinstance(m.get(key), str | int | float):
            lines.append(f"{key.split('_')[-1]:12} {m[key]}")
    if agent.experiment.training_kwargs.get("leg_area_reward"):
        lines.append("             (the score includes the factor for smaller legs)")
    if isinstance(m.get("settings"), dict) and m["settings"].get("reward_weights"):
        lines.append("             (the score is that of the settings' reward_weights)")
    for label in ("settings", "versions"):
        if isinstance(m.get(label), dict):
            values = ", ".join(f"{k} {v}" for k, v in m[label].items() if v is not None)
            lines.append(f"{label:12} {values}")
    if agent.design is not None:
        space = agent.space
        if "limits" in m:
            lines.append(f"limits       {space.in_words}")
        lines.append(f"design       in % of the original, and in {space.unit}")
        rows = zip(space.names, agent.design, space.dimensions(agent.design), strict=True)
        for name, scale, size in rows:
            lines.append(f"  {name:28} {100 * scale:6.1f} %  {size:8.3f}")
    return "\n".join(map(printable, lines))
