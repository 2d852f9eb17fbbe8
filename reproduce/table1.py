"""Table 1: the learned ant's body in % of the original, the paper's and ours."""

import numpy as np

from designrl.bodies.ant import ANT, ANT_LEGS, ANT_PARTS
from reproduce.paths import paper
from reproduce.scores import MISSING
from reproduce.sources import Sources
from reproduce.tables import PAPER, Table, row

EXPERIMENT = "ant-morphology"
READS = (EXPERIMENT,)


def percentages(scales: np.ndarray) -> np.ndarray:
    """(parts, legs, 2) length and radius in % of the original, of a design of scales (36,).

    A part's length is that of (dx, dy), its ends' distance.
    """

    def sizes(scales):
        legs = ANT.design.dimensions(scales).reshape(len(ANT_LEGS), 9)
        lengths = np.hypot(legs[:, 0:6:2], legs[:, 1:6:2])
        return np.stack([lengths, legs[:, 6:]], axis=-1).swapaxes(0, 1)

    return 100 * sizes(scales) / sizes(np.ones(ANT.design.size))


def tables(sources: Sources) -> list[Table]:
    printed = paper()["table1"]
    found = sources.by_label(EXPERIMENT, scored=False)
    bodies = {PAPER: np.array([printed[part] for part in ANT_PARTS], dtype=float)}
    bodies |= {label: percentages(s.agent.design) for label, s in found.items() if s.agent}

    rows, records = [], []
    for i, part in enumerate(ANT_PARTS):
        rows += [None] if rows else []
        for source, values in bodies.items():
            cells = [f"{value:.0f}%" for value in values[i].ravel()]
            rows.append(row([part.capitalize()], source, cells, EXPERIMENT))
            records += [
                {"part": part, "leg": leg, "source": source, "length": length, "radius": radius}
                for leg, (length, radius) in zip(ANT_LEGS, values[i], strict=True)
            ]
        if len(bodies) == 1:
            rows.append(row([part.capitalize()], "ours", [MISSING, *[""] * 7], EXPERIMENT))
    names = [leg.title().replace("Front", "Top").replace("Back", "Bottom") for leg in ANT_LEGS]
    table = Table(
        "table1",
        "Table 1: the learned ant's body in % of the original, paper and ours",
        header=["", "", *["Length", "Radius"] * 4],
        rows=rows,
        notes=[
            "Length of a part: √(dx² + dy²). The paper's Top Left to Bottom Right are the design's "
            "front left, front right, back left and back right leg; its table is of run 1."
        ],
        records=records,
        scores=list(found.values()),
        groups=[("", 1), ("", 1), *((name, 2) for name in names)],
    )
    return [table]
