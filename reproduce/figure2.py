"""Figure 2: Gym's loop of agent and environment, and the paper's altered one."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reproduce import drawing
from reproduce.sources import Sources

CAPTIONS = {
    "figure2": (
        "Figure 2",
        "Left, Gym's loop. Right, the paper's: the agent's parameters also set the body, once "
        "before a rollout, and the reward may depend on it.",
    )
}
READS = ()


def box(axes: Axes, y: float, text: str, colour: str) -> None:
    """A labelled box in the middle at height y."""
    style = {"boxstyle": "round,pad=0.8", "facecolor": colour + "22", "edgecolor": colour}
    axes.text(0.5, y, text, ha="center", va="center", bbox=style)


def arrow(axes: Axes, start, end, text: str, at, align: str, bend=0.0, colour="black") -> None:
    """An arrow with its label at `at`."""
    style = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
    style["connectionstyle"] = f"arc3,rad={bend}"
    axes.annotate("", end, start, arrowprops=style)
    axes.text(*at, text, ha=align, va="center", color=colour, fontsize=7)


def loop(axes: Axes, altered: bool) -> None:
    """One of the two loops."""
    agent_label = "agent\n" + (r"$w$: policy and design" if altered else r"$w$: policy")
    world_label = "environment\n" + (r"with the body of $w$" if altered else "with a fixed body")
    box(axes, 0.80, agent_label, drawing.ORIGINAL)
    box(axes, 0.22, world_label, drawing.THIRD)
    arrow(axes, (0.40, 0.67), (0.40, 0.35), "action", (0.38, 0.51), "right")
    observed = "observation,\nreward" + " · factor\nof the design" * altered
    arrow(axes, (0.60, 0.35), (0.60, 0.67), observed, (0.62, 0.51), "left")
    if altered:
        text, start, end = "design, once,\nbefore the\nrollout", (0.208, 0.80), (0.228, 0.22)
        arrow(axes, start, end, text, (0.07, 0.51), "right", 0.5, drawing.LEARNED)
    axes.set_xlim(-0.13, 1.0)
    axes.set_ylim(0.07, 1.0)
    axes.set_axis_off()


def figures(sources: Sources) -> dict[str, Figure]:
    figure = Figure(figsize=(drawing.WIDTH, 2.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    loop(left, altered=False)
    left.set_title("Gym's loop of one rollout")
    loop(right, altered=True)
    right.set_title("The altered loop: the agent brings its body")
    return {"figure2": figure}
