"""The weights that the author published in 2018, in his repositories astool and estool.

They are not part of this project: DESIGNRL_ZOO names the folder where they lie.
"""

import os
from contextlib import suppress
from pathlib import Path

from designrl.errors import InputError

RUNS = 10
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


def zoo_folder() -> Path | None:
    """The folder of the author's weights: DESIGNRL_ZOO, or shared/zoo beside this repository.

    None where there is no such folder.
    """
    beside = Path(__file__).resolve().parents[2] / "shared" / "zoo"
    folder = Path(os.environ.get("DESIGNRL_ZOO") or beside)
    return folder if folder.is_dir() else None


def file_name(experiment: str, run: int = 1) -> str:
    """The file of one of the author's runs, seen from a zoo folder."""
    first, more = FILES[experiment]
    return f"{first}.json" if run == 1 else f"more/{more}.{run}.json"


def published(zoo: str | Path, experiment: str, run: int = 1) -> Path:
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


def published_runs(zoo: str | Path, experiment: str) -> dict[int, Path]:
    """Those of the author's runs 1 to 10 that are there."""
    found = {}
    for run in range(1, RUNS + 1):
        with suppress(InputError):
            found[run] = published(zoo, experiment, run)
    return found
