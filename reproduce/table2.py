"""Table 2: the walkers' scores, leg areas and leg dimensions, the paper's and ours.

Reads pretrained/ and paper/paper.toml; with ZOO=path also the author's weights.

    make reproduce-table2
"""

import numpy as np

from designrl.bodies.walker import leg_area
from designrl.experiments import EXPERIMENTS
from reproduce import scores
from reproduce.scores import WALKER
from reproduce.tables import MISSING, PAPER, Table, mean_and_std, row

ENVIRONMENTS = {  # ours -> as the paper names it
    "designrl/BipedalWalker-v0": "BipedalWalker-v2",
    "designrl/BipedalWalkerHardcore-v0": "BipedalWalkerHardcore-v2",
}
WALKERS = tuple(name for name, e in EXPERIMENTS.items() if e.env_id in ENVIRONMENTS)
READS = WALKERS


def place(name: str) -> list[str]:
    """Environment and body of an experiment, as the paper names them."""
    body = "Original" if EXPERIMENTS[name].design is None else "Learnable"
    if scores.rewards_small_legs(name):
        body = "Reward smaller leg"
    return [ENVIRONMENTS[EXPERIMENTS[name].env_id], body]


def legs(scales: np.ndarray) -> tuple[float, np.ndarray]:
    """Leg area in % of the original and (8,) widths and heights in 1/30 m, of (8,) scales."""
    area = 100 * float(leg_area(scales) / leg_area(np.ones(WALKER.size)))
    return area, WALKER.dimensions(scales)


def tables() -> list[Table]:
    """The table."""
    printed = scores.paper()["table2"]
    ours, authors = scores.pretrained_scores(WALKERS), scores.authors_scores(WALKERS)
    rows, records, used = [], [], []

    def add(name: str, source: str, mean, std, area, sizes, sha256="") -> None:
        texts = [mean_and_std(mean, std), f"{area:.0f}%", *(f"{size:.1f}" for size in sizes)]
        rows.append(row(place(name), source, texts, name))
        head = zip(("environment", "body", "source"), [*place(name), source], strict=True)
        values = {"mean": mean, "std": std, "leg_area": area}
        values |= dict(zip(WALKER.names, sizes, strict=True))
        records.append(dict(head) | values | {"sha256": sha256})

    for i, name in enumerate(WALKERS):
        rows += [None] if i == 3 else []
        p = printed[name]
        add(name, PAPER, *p["score"], p["leg_area"], p["dimensions"])
        found = [(f"ours, {s.run}", s) for s in ours[name]]
        found += [("author's weights", s) for run, s in authors[name].items() if run == 1]
        used += [s for _, s in found]
        if not ours[name]:
            rows.append(row(place(name), "ours", [MISSING, *[""] * 9], name))
        for source, s in found:
            if s.problem:
                rows.append([*place(name), source, f"not used: {s.problem}", *[""] * 9])
            else:
                add(name, source, s.mean, s.std, *legs(s.agent.scales), s.sha256)
    parts = [f"{part} leg {leg}" for leg in (1, 2) for part in ("Top", "Bottom")]
    return [
        Table(
            "table2",
            "Table 2: bipedal walkers, paper and ours",
            ["Environment", "Body", "", "Avg. score", "leg area", *["w", "h"] * 4],
            rows,
            [
                "Mean ± standard deviation of the score over 100 rollouts; leg area in % of the "
                "original; widths w and heights h in 1/30 m (the paper's scaled Box2D dimensions). "
                "The paper's rows are its run 1."
            ],
            records,
            used,
            [*[("", 1)] * 5, *((part, 2) for part in parts)],
        )
    ]
