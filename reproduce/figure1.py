"""Figure 1: the walker on hardcore terrain, original body above, learned body below.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's weights
instead.

    make reproduce-figure1
"""

from matplotlib.figure import Figure

from reproduce import drawing

CAPTIONS = {
    "figure1": (
        "Figure 1",
        "Hardcore terrain: the original body above, the learned one below; several moments of one "
        "rollout each, on the terrain of the same seed, drawn from the environment's shapes. The "
        "rollout is the one closest to both agents' medians over the evaluation.",
    )
}
READS = ("biped-hardcore", "biped-hardcore-morphology")
LABELS = ("Original body", "Learned body")


def figures() -> dict[str, Figure]:
    """The figure."""
    return {"figure1": drawing.strips(READS, LABELS)}
