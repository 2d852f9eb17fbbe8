"""Figure 6: walkers rewarded for smaller legs, on flat terrain above, hardcore below.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's weights
instead.

    make reproduce-figure6
"""

from matplotlib.figure import Figure

from reproduce import drawing

CAPTIONS = {
    "figure6": (
        "Figure 6",
        "Walkers rewarded for smaller legs, on flat terrain above, hardcore below.",
    )
}
READS = ("biped-morphology-smaller-leg", "biped-hardcore-morphology-smaller-leg")
LABELS = ("Smaller legs", "Smaller legs, hardcore")


def figures() -> dict[str, Figure]:
    """The figure."""
    return {"figure6": drawing.strips(READS, LABELS)}
