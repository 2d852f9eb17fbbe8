"""Figure 6: walkers rewarded for smaller legs, on flat terrain above, hardcore below."""

from matplotlib.figure import Figure

from reproduce import drawing
from reproduce.sources import Sources

READS = ("biped-morphology-smaller-leg", "biped-hardcore-morphology-smaller-leg")
CAPTION = "Rewarded for smaller legs: walkers on flat terrain above, on hardcore below."
CAPTIONS = {"figure6": ("Figure 6", CAPTION)}


def figures(sources: Sources) -> dict[str, Figure]:
    return {"figure6": drawing.strips(sources, READS, ("Smaller legs", "Smaller legs, hardcore"))}
