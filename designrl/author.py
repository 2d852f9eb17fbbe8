"""The weights that the author published in 2018, in his repositories astool and estool.

They are not part of this project: AUTHOR_ZOO names the folder where they lie. A file is a JSON list
`[parameters, score]`, or of the distribution's mean, `[parameters]`.
"""

import json
import os
from contextlib import suppress
from pathlib import Path

import numpy as np

from designrl.checkpoint import read_bounded
from designrl.errors import InputError, printable, remark
from designrl.experiments import EXPERIMENTS, Experiment
from designrl.files import file_hash
from designrl.policy import Agent
from designrl.provenance import versions

RUNS = 10
# As many numbers as an agent of `ant` with the paper's network; the author's ants have another.
BULLET_ANT = (
    "has the size of estool's bullet_ant, an agent of PyBullet's AntBulletEnv-v0; that is another "
    "world than the paper's ant has, and scores here say nothing of such an agent"
)
# Experiment -> its run 1 in the folder zoo/, and its runs 2 to 10 in zoo/more/, followed there by
# their number.
FILES = {
    "ant": ("robo_ant", "robo_ant/robo_ant"),
    "ant-morphology": ("augment_ant", "augmentant/augment_ant"),
    "biped": ("biped", "biped/biped"),
    "biped-morphology": ("augmentbiped", "augmentbiped/augmentbiped"),
    "biped-morphology-smaller-leg": (
        "augmentbipedsmalllegs",
        "augmentbipedsmall/augmentbipedsmall",
    ),
    "biped-hardcore": ("bipedhard", "bipedhard/bipedhard"),
    "biped-hardcore-morphology": ("augmentbipedhard", "augmentbipedhard/augmentbipedhard"),
    "biped-hardcore-morphology-smaller-leg": (
        "augmentbipedhardsmalllegs",
        "augmentbipedhardsmall/augmentbipedhardsmalllegs",
    ),
}


def zoo() -> Path | None:
    """The folder that AUTHOR_ZOO names; None where it is not set or there is no such folder."""
    folder = os.environ.get("AUTHOR_ZOO")
    return Path(folder) if folder and Path(folder).is_dir() else None


def file_name(experiment: str, run: int = 1) -> str:
    """The file of one of the author's runs, seen from a zoo folder."""
    first, more = FILES[experiment]
    return f"{first}.json" if run == 1 else f"more/{more}.{run}.json"


def file_of(zoo: str | Path, experiment: str, run: int = 1) -> Path:
    """The author's file of a run in a zoo folder of 2018, a clone with one, or a folder of clones.

    Raises:
        InputError: it is not there; the message says what was looked for.
    """
    name = file_name(experiment, run)
    for folder in (Path(zoo), Path(zoo) / "zoo", *sorted(Path(zoo).glob("*/zoo"))):
        if (folder / name).is_file():
            return folder / name
    raise InputError(
        f"{zoo} has no {name}, nor have its folders zoo and */zoo; name the 2018 zoo folder"
    )


def runs(zoo: str | Path, experiment: str) -> dict[int, Path]:
    """Those of the author's runs 1 to 10 that are there."""
    found = {}
    for run in range(1, RUNS + 1):
        with suppress(InputError):
            found[run] = file_of(zoo, experiment, run)
    return found


def load_author(path: str | Path, experiment: Experiment) -> Agent:
    """The agent of a JSON file of the 2018 repositories: `[parameters, score]` or `[parameters]`.

    Raises:
        InputError: missing, not such a list, or of another length than the experiment's networks.
    """
    path = Path(path)
    parameters, score = _read(path)
    network = experiment.network
    for other in experiment.other_networks:
        if parameters.shape == (experiment.parameters_with(other),):
            network = other
    metadata = {
        "source": f"the author's weights of 2018 ({path.name})",
        "source_sha256": file_hash(path),
        **({} if score is None else {"score": score}),
        "versions": versions(),
    }
    try:
        agent = Agent(experiment, parameters, network, metadata)
    except InputError as error:
        names = fitting(parameters.size)
        could = f"; by its size it can be of {' or '.join(names)}" if names else ""
        raise InputError(f"{path} cannot be used as {experiment.name}: {error}{could}") from None
    if _is_bullet_ant(parameters):
        remark(f"{path} {BULLET_ANT}")
    return agent


def _is_bullet_ant(parameters: np.ndarray) -> bool:
    ant = EXPERIMENTS["ant"]
    return parameters.size == ant.parameters_with(ant.network)


def fitting(parameters: int) -> list[str]:
    """Names of the experiments whose agents have so many parameters."""
    return [
        name
        for name, e in EXPERIMENTS.items()
        if parameters in (e.parameters_with(network) for network in e.networks)
    ]


def _read(path: Path) -> tuple[np.ndarray, float | None]:
    data = read_bounded(path)
    try:
        parameters, *score = json.loads(data.decode())
        if len(score) > 1:
            raise ValueError("too many values")
        return np.array(parameters, dtype=np.float64), float(score[0]) if score else None
    except (ValueError, TypeError, RecursionError, OverflowError):
        raise InputError(
            f"{path} is not a 2018 weights file; name a .json that holds [parameters, score] or "
            "[parameters]"
        ) from None


def describe(path: str | Path) -> str:
    """What one of the author's files holds, and which experiments it fits, as text.

    Raises:
        InputError: as `load_author`.
    """
    path = Path(path)
    parameters, score = _read(path)
    about = "no score" if score is None else f"score {score:.2f}"
    text = f"{path}: the author's weights of 2018, {parameters.size} numbers, {about}"
    fits = ", ".join(fitting(parameters.size)) or "none"
    doubt = f"; it {BULLET_ANT}" if _is_bullet_ant(parameters) else ""
    return printable(f"{text}; experiments with as many: {fits}{doubt}")
