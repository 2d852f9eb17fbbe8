"""Figure 1: the walker on hardcore terrain, original body above, learned body below."""

from matplotlib.figure import Figure

from reproduce import drawing
from reproduce.sources import Sources

READS = ("biped-hardcore", "biped-hardcore-morphology")
CAPTIONS = {
    "figure1": (
        "Figure 1",
        "Hardcore terrain: the original body above, the learned one below; several moments of one "
        "rollout each, on the terrain of the same seed, drawn from the environment's shapes. The "
        "rollout is the one closest to both agents' medians over the evaluation. Of our runs, "
        "Figures 1, 3, 4 and 6 show the best of each experiment.",
    )
}


def figures(sources: Sources) -> dict[str, Figure]:
    return {"figure1": drawing.strips(sources, READS, ("Original body", "Learned body"))}
