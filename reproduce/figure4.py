"""Figure 4: the walker on flat terrain, original body above, learned body below.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's weights
instead.

    make reproduce-figure4
"""

from matplotlib.figure import Figure

from reproduce import drawing

CAPTIONS = {
    "figure4": (
        "Figure 4",
        "Flat terrain: the original body above, the learned one below.",
    )
}
READS = ("biped", "biped-morphology")
LABELS = ("Original body", "Learned body")


def figures() -> dict[str, Figure]:
    """The figure."""
    return {"figure4": drawing.strips(READS, LABELS)}
