"""Figure 7: two further designs, each of another run than in Figures 1 and 4.

Reads the checkpoints of both experiments in pretrained/; with ZOO=path the author's run 9 instead,
which is the one of the paper's figure.

    make reproduce-figure7
"""

from matplotlib.figure import Figure

from reproduce import drawing

CAPTIONS = {
    "figure7": (
        "Figure 7",
        "Further designs: of each experiment another run than in the figures before.",
    )
}
READS = ("biped-morphology", "biped-hardcore-morphology")
LABELS = ("Another design", "Another design, hardcore")


def figures() -> dict[str, Figure]:
    """The figure."""
    return {"figure7": drawing.strips(READS, LABELS, rank=1)}
