"""Figure 4: the walker on flat terrain, original body above, learned body below."""

from matplotlib.figure import Figure

from reproduce import drawing
from reproduce.sources import Sources

READS = ("biped", "biped-morphology")
CAPTIONS = {
    "figure4": ("Figure 4", "Flat terrain: the original body above, the learned one below.")
}


def figures(sources: Sources) -> dict[str, Figure]:
    return {"figure4": drawing.strips(sources, READS, ("Original body", "Learned body"))}
