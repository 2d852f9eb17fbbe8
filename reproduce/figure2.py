"""Figure 2: Gym's loop of agent and environment, and the paper's altered one.

Reads nothing.

    make reproduce-figure2
"""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from reproduce import drawing

CAPTIONS = {
    "figure2": (
        "Figure 2",
        "Left, Gym's loop. Right, the paper's: the agent's parameters also set the body, once "
        "before a rollout, and the reward may depend on it.",
    )
}
READS = ()
BOX = 0.48, 0.17  # width and height, of a panel


def box(axes: Axes, x: float, y: float, text: str, colour: str) -> None:
    """A labelled box around (x, y)."""
    width, height = BOX
    axes.add_patch(
        FancyBboxPatch(
            (x - width / 2, y - height / 2),
            width,
            height,
            boxstyle="round,pad=0.02",
            facecolor=colour + "22",
            edgecolor=colour,
        )
    )
    axes.text(x, y, text, ha="center", va="center")


def arrow(axes: Axes, start, end, text: str, at, align: str, colour: str = "black") -> None:
    """A straight arrow with its label at `at`."""
    axes.add_patch(
        FancyArrowPatch(
            start, end, arrowstyle="-|>", mutation_scale=9, color=colour, shrinkA=0, shrinkB=0
        )
    )
    axes.text(*at, text, ha=align, va="center", color=colour, fontsize=7)


def loop(axes: Axes, altered: bool) -> None:
    """One of the two loops."""
    agent_label = "agent\n" + (r"$w$: policy and design" if altered else r"$w$: policy")
    world_label = "environment\n" + (r"with the body of $w$" if altered else "with a fixed body")
    box(axes, 0.5, 0.80, agent_label, drawing.ORIGINAL)
    box(axes, 0.5, 0.22, world_label, drawing.THIRD)
    arrow(axes, (0.40, 0.69), (0.40, 0.33), "action", (0.38, 0.51), "right")
    observed = "observation,\nreward"
    if altered:
        observed = "observation,\nreward · factor\nof the design"
    arrow(axes, (0.60, 0.33), (0.60, 0.69), observed, (0.62, 0.51), "left")
    if altered:
        axes.add_patch(
            FancyArrowPatch(
                (0.24, 0.80),
                (0.24, 0.22),
                connectionstyle="arc3,rad=0.5",
                arrowstyle="-|>",
                mutation_scale=9,
                color=drawing.LEARNED,
                shrinkA=0,
                shrinkB=0,
            )
        )
        text = "design, once,\nbefore the\nrollout"
        axes.text(0.08, 0.51, text, ha="right", va="center", color=drawing.LEARNED, fontsize=7)
    axes.set_xlim(-0.13, 1.0)
    axes.set_ylim(0.07, 1.0)
    axes.set_axis_off()


def figures() -> dict[str, Figure]:
    """The figure."""
    figure = Figure(figsize=(drawing.WIDTH, 2.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    loop(left, altered=False)
    left.set_title("Gym's loop of one rollout")
    loop(right, altered=True)
    right.set_title("The altered loop: the agent brings its body")
    return {"figure2": figure}
