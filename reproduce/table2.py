"""Table 2: the walkers' scores, leg areas and leg dimensions, the paper's and ours.

Reads pretrained/ and paper/paper.toml; with ZOO=path also the author's weights. Writes
paper/tables/table2.md, .tex and .csv, and prints the table.

    make reproduce-table2
"""

from pathlib import Path

import numpy as np

from designrl.bodies.walker import WALKER, leg_area
from designrl.experiments import EXPERIMENTS
from reproduce import build, scores
from reproduce.scores import Score
from reproduce.tables import MISSING, mean_and_std, origin_notes, scoring_note, write_table

WALKERS = [name for name, experiment in EXPERIMENTS.items() if experiment.is_walker]
BLOCKS = ("BipedalWalker-v2", "BipedalWalkerHardcore-v2")
ROWS = ("Original", "Learnable", "Reward smaller leg")  # of each block, in Table 3's order


def reads() -> list[Path]:
    """The files that the table depends on."""
    return scores.read_for(*WALKERS)


def record(label: list[str], mean, std, area, dimensions, sha256="") -> dict:
    """A row of the CSV; area in % of the original, dimensions in 1/30 m."""
    sizes = dict(zip(WALKER.design.names, dimensions, strict=True))
    head = dict(zip(("environment", "body", "source"), label, strict=True))
    return {**head, "mean": mean, "std": std, "leg_area": area, **sizes, "sha256": sha256}


def measured(label: list[str], s: Score) -> tuple[list[str], dict]:
    """Cells and CSV row of a scored checkpoint."""
    if s.problem:
        cells = [f"not used: {s.problem}", *[""] * 9]
        return [*label, *cells], record(label, "", "", "", [""] * 8)
    body = s.agent.body
    area = 100 * float(leg_area(body) / leg_area(np.ones(WALKER.design.size)))
    sizes = WALKER.design.dimensions(body)
    cells = [mean_and_std(s.mean, s.std), f"{area:.0f}%", *(f"{size:.1f}" for size in sizes)]
    return [*label, *cells], record(label, s.mean, s.std, area, sizes, s.sha256)


def main() -> list[Path]:
    """Write the table; returns its files."""
    printed = scores.paper()["table2"]
    zoo = scores.zoo_argument()
    ours = scores.pretrained_scores(WALKERS)
    authors = scores.published_scores(zoo, WALKERS)
    rows, records = [], []
    for i, name in enumerate(WALKERS):
        if i == len(ROWS):
            rows.append(None)
        place = [BLOCKS[EXPERIMENTS[name].hardcore], ROWS[i % len(ROWS)]]
        paper = printed[name]
        mean, std = paper["score"]
        sizes = [f"{size:.1f}" for size in paper["dimensions"]]
        rows.append([*place, "paper", f"{mean} ± {std}", f"{paper['leg_area']}%", *sizes])
        label = [*place, "paper"]
        records.append(record(label, mean, std, paper["leg_area"], paper["dimensions"]))
        found = [(f"ours, {scores.seed_of(s.path)}", s) for s in ours[name]]
        found += [("author's weights", s) for run, s in authors[name].items() if run == 1]
        if not ours[name]:
            rows.append([*place, "ours", MISSING, *[""] * 9])
        for source, s in found:
            cells, values = measured([*place, source], s)
            rows.append(cells)
            records.append(values)
    notes = [
        "Mean ± standard deviation of the score over 100 rollouts; leg area in % of the original; "
        "widths w and heights h in 1/30 m (the paper's scaled Box2D dimensions). The paper's rows "
        "are its run 1.",
        scoring_note(),
        *origin_notes(
            s for name in WALKERS for s in (*ours[name], *list(authors[name].values())[:1])
        ),
    ]
    legs = [f"{part} leg {leg}" for leg in (1, 2) for part in ("Top", "Bottom")]
    return write_table(
        "table2",
        "Table 2: bipedal walkers, paper and ours",
        ["Environment", "Body", "", "Avg. score", "leg area", *["w", "h"] * 4],
        rows,
        notes,
        records,
        [*[("", 1)] * 5, *((leg, 2) for leg in legs)],
    )


if __name__ == "__main__":
    build.command("table2")
