"""Figure 7: two further designs, each of another run than in Figures 1 and 4."""

from matplotlib.figure import Figure

from reproduce import drawing
from reproduce.sources import Sources

READS = ("biped-morphology", "biped-hardcore-morphology")
CAPTIONS = {
    "figure7": (
        "Figure 7",
        "Further designs: of each experiment another run than in the figures before, of ours the "
        "second best.",
    )
}


def figures(sources: Sources) -> dict[str, Figure]:
    labels = ("Another design", "Another design, hardcore")
    return {"figure7": drawing.strips(sources, READS, labels, rank=1)}
