"""Figure 3: the ant, original body above, learned body below, with diagrams of both.

The pictures are PyBullet's, as the environment renders them; the diagrams show the legs stretched
out flat, from above. Reads the checkpoints of both experiments in pretrained/; with ZOO=path the
author's weights instead. Writes paper/figures/figure3.svg, .pdf and .png.

    make reproduce-figure3
"""

from pathlib import Path

import gymnasium
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from designrl.bodies.ant import ANT, ANT_LEGS, ANT_PARTS, TORSO_RADIUS, leg_capsules
from designrl.experiments import EXPERIMENTS
from reproduce import build, drawing, scores
from reproduce.scores import Score

ROWS = [("Original body", "ant"), ("Learned body", "ant-morphology")]
STEPS = (150, 155, 160, 165, 170)  # moments of a stride or two
CROP = (slice(60, 440), slice(90, 550))  # of the environment's 480 x 640 pictures
COLOURS = {"top": "#4C4C5C", "middle": drawing.LEARNED, "bottom": "#E69F00"}


def reads() -> list[Path]:
    """The files that the figure depends on."""
    return scores.read_for(*(experiment for _, experiment in ROWS))


def printed_design() -> np.ndarray:
    """(36,) scales of Table 1's body; it prints lengths alone, so dx and dy share a scale."""
    printed = scores.paper()["table1"]
    legs = []
    for leg in range(len(ANT_LEGS)):
        lengths, radii = zip(*(printed[part][leg] for part in ANT_PARTS), strict=True)
        legs += [*np.repeat(lengths, 2), *radii]
    return np.clip(np.array(legs) / 100, 0.25, 1.75)


def pictures(experiment: str, body: np.ndarray, s: Score | None) -> list[np.ndarray]:
    """The environment's pictures at STEPS of one rollout; without an agent, one of the start."""
    env_id = EXPERIMENTS[experiment].env_id
    env = gymnasium.make(env_id, design=body, render_mode="rgb_array", disable_env_checker=True)
    seed = drawing.typical_seed(s)
    observation, _ = env.reset(seed=seed)
    taken = []
    if s is None:
        taken.append(env.render()[CROP])
    else:
        s.agent.reset(seed)
        for step in range(STEPS[-1]):
            observation, _, terminated, truncated, _ = env.step(s.agent.act(observation, step))
            if terminated or truncated:
                break
            if step + 1 in STEPS:
                taken.append(env.render()[CROP])
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
        capsule(axes, start, tips[part.name], part.radius, COLOURS[part.name.split()[-1]])
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


def main() -> list[Path]:
    """Draw the figure; returns its files."""
    figure = Figure(figsize=(drawing.WIDTH, 4.6), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=[2.4, 2.1])
    strips = above.subplots(2, 1)
    diagrams = below.subplots(1, 2)
    for strip, plan, (label, experiment) in zip(strips, diagrams, ROWS, strict=True):
        s = scores.representative(experiment)
        learned = EXPERIMENTS[experiment].design is not None
        body = s.agent.body if s else printed_design() if learned else np.ones(ANT.design.size)
        title = f"{label}: no checkpoint of ours yet; the paper's design, at the start"
        if s:
            title = (
                f"{label}: {s.mean:.0f} ± {s.std:.0f} over {scores.EPISODES} rollouts "
                f"({drawing.source_of(s)})"
            )
        strip.set_title(title)
        strip.set_axis_off()
        taken = pictures(experiment, body, s)
        height, width, _ = taken[0].shape
        for i, picture in enumerate(taken):
            strip.imshow(picture, extent=(i * width, (i + 0.98) * width, 0, height))
            if s:
                text = f"{STEPS[i] * ANT.time_step:.2f} s"
                strip.text((i + 0.04) * width, 0.95 * height, text, va="top", fontsize=7)
        strip.set_xlim(0, len(STEPS) * width)
        strip.set_ylim(0, height)
        diagram(plan, body)
        plan.set_title(f"{label}, from above" + ("" if s else " (the paper's)"))
    return drawing.save(figure, "figure3")


if __name__ == "__main__":
    build.command("figure3")
