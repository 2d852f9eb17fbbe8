"""Table 1: the learned ant's body in % of the original, the paper's and ours.

Reads pretrained/ant-morphology/ and paper/paper.toml; with ZOO=path also the author's weights.
Writes paper/tables/table1.md, .tex and .csv, and prints the table.

    make reproduce-table1
"""

from pathlib import Path

import numpy as np

from designrl.bodies.ant import ANT, ANT_LEGS, ANT_PARTS
from designrl.errors import InputError
from reproduce import build, scores
from reproduce.tables import MISSING, origin_notes, write_table

EXPERIMENT = "ant-morphology"


def percentages(scales: np.ndarray) -> np.ndarray:
    """(parts, legs, 2) length and radius in % of the original, of a design of scales (36,).

    A part's length is that of (dx, dy), its ends' distance.
    """

    def sizes(scales):
        legs = ANT.design.dimensions(scales).reshape(len(ANT_LEGS), 9)
        lengths = np.hypot(legs[:, 0:6:2], legs[:, 1:6:2])
        return np.stack([lengths, legs[:, 6:]], axis=-1).swapaxes(0, 1)

    return 100 * sizes(scales) / sizes(np.ones(ANT.design.size))


def reads() -> list[Path]:
    """The files that the table depends on."""
    return scores.read_for(EXPERIMENT)


def main() -> list[Path]:
    """Write the table; returns its files."""
    printed = scores.paper()["table1"]
    zoo = scores.zoo_argument()
    ours = [scores.load_design(path, EXPERIMENT) for path in scores.pretrained(EXPERIMENT)]
    bodies = {"paper": np.array([printed[part] for part in ANT_PARTS], dtype=float)}
    bodies |= {
        f"ours, {scores.seed_of(s.path)}": percentages(s.agent.design) for s in ours if s.agent
    }
    problem = ""
    if zoo:
        try:
            theirs = scores.load_design(scores.published(zoo, EXPERIMENT), EXPERIMENT)
            ours.append(theirs)
            if theirs.agent:
                bodies["author's weights"] = percentages(theirs.agent.design)
        except InputError as error:
            problem = f"Author's weights: {error}."

    rows, records = [], []
    for i, part in enumerate(ANT_PARTS):
        rows.append(None) if rows else None
        for source, values in bodies.items():
            cells = [f"{value:.0f}%" for value in values[i].ravel()]
            rows.append([part.capitalize(), source, *cells])
            records += [
                {"part": part, "leg": leg, "source": source, "length": length, "radius": radius}
                for leg, (length, radius) in zip(ANT_LEGS, values[i], strict=True)
            ]
        if len(bodies) == 1:
            rows.append([part.capitalize(), "ours", MISSING, *[""] * 7])
    names = [leg.title().replace("Front", "Top").replace("Back", "Bottom") for leg in ANT_LEGS]
    notes = [
        "Length of a part: √(dx² + dy²). The paper's Top Left to Bottom Right are the design's "
        "front left, front right, back left and back right leg; its table is of run 1.",
        *([problem] if problem else []),
        *origin_notes(ours),
    ]
    return write_table(
        "table1",
        "Table 1: the learned ant's body in % of the original, paper and ours",
        ["", "", *["Length", "Radius"] * 4],
        rows,
        notes,
        records,
        [("", 1), ("", 1), *((name, 2) for name in names)],
    )


if __name__ == "__main__":
    build.command("table1")
