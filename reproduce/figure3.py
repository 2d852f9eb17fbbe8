"""Figure 3: the ant, original body above, learned body below, with diagrams of both.

The pictures are PyBullet's, as the environment renders them; the diagrams show the legs stretched
out flat, from above.
"""

import gymnasium
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from designrl.bodies.ant import ANT, ANT_LEGS, TORSO_RADIUS, leg_capsules
from reproduce import drawing
from reproduce.scores import EPISODES, MISSING, Score
from reproduce.sources import Sources
from reproduce.tables import mean_and_std

CAPTIONS = {
    "figure3": (
        "Figure 3",
        "The ant: moments of one rollout as the environment renders them, original body above, "
        "learned body below; then both bodies from above with the legs stretched out flat. The "
        "legs have the paper's names, which follow an ant that faces y (left): in the walk along "
        "x, front left and back right lead.",
    )
}
READS = ("ant", "ant-morphology")
LABELS = ("Original body", "Learned body")
STEPS = (150, 155, 160, 165, 170)  # moments of a stride or two
CROP = (slice(60, 440), slice(90, 550))  # of the environment's 480 x 640 pictures
COLOURS = {"top": "#4C4C5C", "middle": drawing.LEARNED, "bottom": "#E69F00"}


def pictures(s: Score) -> list[np.ndarray]:
    """The environment's pictures at STEPS of one rollout."""
    env_id = s.agent.experiment.env_id
    env = gymnasium.make(env_id, render_mode="rgb_array", disable_env_checker=True)
    taken = []
    for step in s.agent.play(env, drawing.typical_seed(s)):
        if step.t + 1 in STEPS:
            taken.append(env.render()[CROP])
        if step.t + 1 == STEPS[-1]:
            break
    env.close()
    return taken


def diagram(axes: Axes, body: np.ndarray) -> None:
    """The ant from above, legs flat, x ahead (up), parts in colours."""
    torso = Circle((0, 0), TORSO_RADIUS, facecolor="#D8D8E4", edgecolor="#4C4C5C", linewidth=0.6)
    axes.add_patch(torso)
    tips = {"torso": np.zeros(2)}  # far ends of the parts: (x ahead, y left)
    for part in leg_capsules(body):
        start = tips[part.parent]
        tips[part.name] = start + np.array(part.end[:2])
        capsule(axes, start, tips[part.name], part.radius, COLOURS[part.kind])
    axes.set_aspect("equal")
    axes.set_xlim(2.4, -2.4)  # left of the ant is left
    axes.set_ylim(-1.8, 1.8)
    axes.set_xlabel("to the left (m)")
    axes.set_ylabel("ahead (m)")
    for name, (x, y) in zip(ANT_LEGS, ((1, 1), (-1, 1), (-1, -1), (1, -1)), strict=True):
        axes.text(2.3 * y, 1.55 * x - 0.05, name, fontsize=7, ha="left" if y > 0 else "right")


def capsule(axes: Axes, start, end, radius: float, colour: str) -> None:
    """A capsule in the plane; points are (x ahead, y left)."""
    along = (end - start) / np.hypot(*(end - start))
    angle = np.arctan2(along[1], along[0])
    turn = np.linspace(np.pi / 2, 3 * np.pi / 2, 13) + angle
    near = start + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    far = end - radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    outline = np.concatenate([near, far])[:, ::-1]  # (left, ahead)
    axes.add_collection(
        PatchCollection([Polygon(outline)], facecolor=colour, edgecolor="black", linewidth=0.3)
    )


def figures(sources: Sources) -> dict[str, Figure]:
    figure = Figure(figsize=(drawing.WIDTH, 4.6), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=[2.4, 2.1])
    strips = above.subplots(2, 1)
    diagrams = below.subplots(1, 2)
    for strip, plan, label, experiment in zip(strips, diagrams, LABELS, READS, strict=True):
        s = sources.representative(experiment)
        strip.set_axis_off()
        if s is None:
            strip.set_title(f"{label}: {MISSING}")
            plan.set_axis_off()
            continue
        strip.set_title(
            f"{label}: {mean_and_std(s.mean, s.std)} over {EPISODES} rollouts "
            f"({drawing.source_of(s)})"
        )
        for i, picture in enumerate(pictures(s)):
            height, width, _ = picture.shape
            strip.imshow(picture, extent=(i * width, (i + 0.98) * width, 0, height))
            text = f"{STEPS[i] * ANT.time_step:.2f} s"
            strip.text((i + 0.04) * width, 0.95 * height, text, va="top", fontsize=7)
        strip.set_xlim(0, len(STEPS) * width)
        strip.set_ylim(0, height)
        diagram(plan, s.agent.scales)
        plan.set_title(f"{label}, from above")
    return {"figure3": figure}
