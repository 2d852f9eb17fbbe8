"""Table 2: the walkers' scores, leg areas and leg dimensions, the paper's and ours."""

import numpy as np

from designrl.bodies.walker import WALKER, leg_area
from reproduce.paths import EIGHT, paper, pretrained
from reproduce.scores import MISSING, rewards_small_legs
from reproduce.sources import OURS, Sources
from reproduce.tables import PAPER, Table, csv_file, mean_and_std, read_csv, row

ENVIRONMENTS = {  # ours -> as the paper names it
    "designrl/BipedalWalker-v0": "BipedalWalker-v2",
    "designrl/BipedalWalkerHardcore-v0": "BipedalWalkerHardcore-v2",
}
WALKERS = tuple(name for name, e in EIGHT.items() if e.env_id in ENVIRONMENTS)
READS = WALKERS


def place(name: str) -> list[str]:
    """Environment and body of an experiment, as the paper names them."""
    body = "Original" if EIGHT[name].design is None else "Learnable"
    if rewards_small_legs(name):
        body = "Reward smaller leg"
    return [ENVIRONMENTS[EIGHT[name].env_id], body]


def our_leg_areas(experiment: str) -> list[float]:
    """Leg areas of our runs in % of the original, as the table's CSV has them; of the recipe's."""
    rows = [row for row in read_csv(csv_file("table2")) if row["experiment"] == experiment]
    return [float(row["leg_area"]) for row in rows if row["source"].startswith(f"{OURS}, seed")]


def legs(scales: np.ndarray) -> tuple[float, np.ndarray]:
    """Leg area in % of the original and (8,) widths and heights in 1/30 m, of (8,) scales."""
    area = 100 * float(leg_area(scales) / leg_area(np.ones(WALKER.design.size)))
    return area, WALKER.design.dimensions(scales)


def tables(sources: Sources) -> list[Table]:
    printed = paper()["table2"]
    rows, records, used = [], [], []

    def add(name: str, source: str, mean, std, area, sizes, sha256="") -> None:
        environment, body = place(name)
        texts = [mean_and_std(mean, std), f"{area:.0f}%", *(f"{size:.1f}" for size in sizes)]
        rows.append(row([environment, body], source, texts, name))
        records.append(
            {"experiment": name, "environment": environment, "body": body, "source": source}
            | {"mean": mean, "std": std, "leg_area": area}
            | dict(zip(WALKER.design.names, sizes, strict=True))
            | {"sha256": sha256}
        )

    for i, name in enumerate(WALKERS):
        rows += [None] if i == 3 else []
        p = printed[name]
        add(name, PAPER, *p["score"], p["leg_area"], p["dimensions"])
        if not pretrained(name):
            rows.append(row(place(name), "ours", [MISSING, *[""] * 9], name))
        found = sources.by_label(name)
        used += found.values()
        for source, s in found.items():
            if s.problem:
                rows.append([*place(name), source, f"not used: {s.problem}", *[""] * 9])
            else:
                add(name, source, s.mean, s.std, *legs(s.agent.scales), s.sha256)
    parts = [f"{part} leg {leg}" for leg in (1, 2) for part in ("Top", "Bottom")]
    table = Table(
        "table2",
        "Table 2: bipedal walkers, paper and ours",
        header=["Environment", "Body", "", "Avg. score", "leg area", *["w", "h"] * 4],
        rows=rows,
        notes=[
            "Mean ± standard deviation of the score over 100 rollouts; leg area in % of the "
            "original; widths w and heights h in 1/30 m (the paper's scaled Box2D dimensions). "
            "The paper's rows are its run 1."
        ],
        records=records,
        scores=used,
        groups=[*[("", 1)] * 5, *((part, 2) for part in parts)],
    )
    return [table]
