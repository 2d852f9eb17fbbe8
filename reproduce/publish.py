"""Publish a training run: its checkpoint and card to pretrained/, its recordings to logs/.

    python -m reproduce.publish runs/biped-morphology/seed0
    python -m reproduce.publish --cards     # all cards anew, from what is published

logs/EXPERIMENT/seedK is a run's folder itself, with generations dropped (never rounded) and three
of its rollouts: copy it to runs/EXPERIMENT/seedK and `designrl train EXPERIMENT ... --resume` goes
on with the run, on any machine. Publishing again replaces what was there, but for what stands in
the card under "Notes", which is for people to write.
"""

import argparse
import json
import shutil
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from designrl.checkpoint import STATE_FORMAT, load, read_tensors
from designrl.errors import InputError
from designrl.experiments import EXPERIMENTS, Experiment
from designrl.files import file_hash
from designrl.recording import Recording, read, thin
from designrl.recording.mcap_file import RESUMED, RUN
from designrl.settings import PUBLISHED, SCHEDULES, TrainSettings, describe_schedule
from designrl.train import OBSERVING_SETTINGS
from reproduce import drawing, scores
from reproduce.figure5 import curve

KEPT = {"mean": "mean of the distribution", "best": "best candidate"}
LETTER = 0.0095, 0.065  # of a label in a learning curve: parts of its width and height
KEPT_GENERATIONS = 40  # about as many stay in a published recording


def main(argv: list[str] | None = None) -> None:
    """Publish the run in a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("run", type=Path, nargs="?", help="the run's folder")
    what.add_argument("--cards", action="store_true", help="write all published runs' cards anew")
    parser.add_argument(
        "--replace", action="store_true", help="also where the published agent scored higher"
    )
    args = parser.parse_args(argv)
    try:
        if args.cards:
            for name in EXPERIMENTS:
                for checkpoint in scores.pretrained(name):
                    card, picture = write_card(checkpoint, scores.log_of(checkpoint))
                    print(f"{card} and {picture} written")
            return
        print(publish(args.run, args.replace))
    except (InputError, OSError) as error:
        sys.exit(f"publish: {error}")


def publish(run: Path, replace: bool = False) -> str:
    """Check the run, then write all that is published of it; returns what was written.

    Raises:
        InputError: the run is damaged or worse than what is published; nothing has been changed.
    """
    read_tensors(run / "state.safetensors", STATE_FORMAT)  # refuses a damaged one
    agent = load(run / "best.safetensors")
    recording = read(run / "generations.mcap")
    if len(recording.generations) == 0:
        raise InputError(f"{recording.path} holds no generation; train further")
    experiment, seed = agent.experiment.name, agent.metadata["seed"]
    checkpoint = scores.ROOT / "pretrained" / experiment / f"seed{seed}.safetensors"
    log = scores.log_of(checkpoint)
    if run.resolve() == log.resolve():
        raise InputError(f"{run} is what is published; copy it to runs/ and go on there")
    rollouts = sorted((run / "rollouts").glob("*.mcap"))
    best = run / "rollouts" / f"generation{agent.metadata['generation']:05d}.mcap"
    if best not in rollouts:
        raise InputError(f"{best} is missing; it is the kept agent's rollout")
    if checkpoint.exists() and not replace:
        published = load(checkpoint).metadata["score"]
        if published > agent.metadata["score"]:
            raise InputError(
                f"{checkpoint} scored {published:.1f}, this run {agent.metadata['score']:.1f}; add "
                "--replace to publish it all the same"
            )
    (log / "rollouts").mkdir(parents=True, exist_ok=True)
    every = max(1, len(recording.generations) // KEPT_GENERATIONS)
    thin(run / "generations.mcap", log / "generations.mcap", every=every)
    for name in ("state.safetensors", "best.safetensors"):
        shutil.copyfile(run / name, log / name)
    for old in (log / "rollouts").iterdir():
        old.unlink()
    for path in {rollouts[0], halfway(rollouts[: rollouts.index(best) + 1], recording), best}:
        shutil.copyfile(path, log / "rollouts" / path.name)
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(run / "best.safetensors", checkpoint)
    card, picture = write_card(checkpoint, log)
    return f"{checkpoint}, {card}, {picture} and {log} written"


def halfway(rollouts: list[Path], recording: Recording) -> Path:
    """Of a run's rollouts, the one whose evaluation is nearest to the middle of first and last."""
    # Between evaluations, too: a rollout that was recorded afterwards had none of its own.
    evaluated = recording.array("/evaluation", "generation") + 1
    at = [int(path.stem.removeprefix("generation")) for path in rollouts]
    score = np.interp(at, evaluated, recording.array("/evaluation", "mean"))
    return rollouts[np.argmin(np.abs(score - (score[0] + score[-1]) / 2))]


def observed(recording: Recording, name: str) -> list[tuple[int, object]]:
    """What a run's recording says of a setting that any resumption may change: (from, value)."""
    found: list[tuple[int, object]] = []
    for record, values in recording.metadata_records:
        if record in (RUN, RESUMED):
            start = int(values.get("generation", 0))
            value = getattr(TrainSettings(**json.loads(values["settings"])), name)
            found = [part for part in found if part[0] < start]
            if not found or found[-1][1] != value:
                found.append((start, value))
    return found


def evaluated_in_parts(recording: Recording) -> bool:
    """Whether a run's agents were not all chosen in the same way."""
    return any(len(observed(recording, name)) > 1 for name in OBSERVING_SETTINGS[1:])


def _in_parts(recording: Recording, name: str, words: dict | None = None) -> str:
    return ", ".join(
        str((words or {}).get(value, value)) + (f" from generation {start}" if start else "")
        for start, value in observed(recording, name)
    )


RATE_SIGNS = {
    "learning_rate": "α",
    "sigma_decay": "σ ×",
    "weight_decay": "decay",
    "decoupled_weight_decay": "AdamW",
}


def _settings_lines(settings: TrainSettings, generation: int) -> list[str]:
    """A generation's settings, those that the run changes at some time, as lines of a label."""
    value = {name: settings.at(name, generation) for name in SCHEDULES}
    lines = [f"{value['population']} × {value['rollouts']}"]
    for name, sign in RATE_SIGNS.items():
        if len(getattr(settings, name)) > 1:
            lines.append(f"{sign} {value[name]:g}")
    if len(settings.shaped_rewards) > 1 or not value["shaped_rewards"]:
        lines.append("shaped rewards" if value["shaped_rewards"] else "plain rewards")
    return lines


def learning_curve(recording: Recording, experiment: Experiment, settings: TrainSettings) -> Figure:
    """The population's return and the evaluated agents' scores over environment steps."""
    c = curve(recording)
    figure = Figure(figsize=(drawing.WIDTH, 2.6), layout="constrained")
    axes = figure.subplots()
    generations, steps, _ = c.at
    low, high = c.mean - 2 * c.sd, c.mean + 2 * c.sd
    axes.fill_between(steps, low, high, color=drawing.ORIGINAL, alpha=0.2, linewidth=0)
    colour = drawing.ORIGINAL
    label = "population's mean ± 2 sd, training's rewards"
    axes.plot(steps, c.mean, color=colour, linewidth=0.8, label=label)
    label = f"evaluated agent ({c.episodes} episodes)"
    if experiment.leg_area_reward:
        label += ", with the smaller-leg factor"
    axes.plot(steps[c.tested], c.scores, ".", color=drawing.LEARNED, markersize=3, label=label)
    if not experiment.leg_area_reward:  # the paper's number is without that factor
        mean, _ = scores.paper()["table3"][experiment.name]
        line = {"color": drawing.GREY, "linestyle": "--", "linewidth": 0.8}
        axes.axhline(mean, label=f"paper's (for dots): {mean}", **line)
    axes.margins(x=0.02)
    # The settings stand where the dots leave room, each as near to the edge as its neighbours let.
    above = len(c.scores) and np.median(c.scores) < np.mean(axes.get_ylim())
    changes = {g for name in SCHEDULES for g, _ in getattr(settings, name)}
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    x, y = (steps[c.tested] - left) / (right - left), (c.scores - low) / (high - low)
    y = 1 - y if above else y
    # What is taken, the dots at first: left, right, distance from the edge at least and at most.
    placed = list(np.stack([x, x, y - 0.015, y + 0.015], axis=1))
    for generation in sorted(g for g in changes if g <= generations[-1]):
        at = np.interp(generation, generations, steps)
        lines = _settings_lines(settings, generation)
        if generation:  # only what changes there
            before = _settings_lines(settings, generation - 1)
            lines = [line for line in lines if line not in before]
            axes.axvline(at, color=drawing.GREY, linewidth=0.5, zorder=0.5)
        start, width = (at - left) / (right - left), LETTER[0] * (2 + max(map(len, lines)))
        if start > 0.9:
            start -= width
        box = np.array([start, start + width, 0.02, 0.02 + LETTER[1] * len(lines)])
        while any(
            box[0] < p[1] and p[0] < box[1] and box[2] < p[3] and p[2] < box[3] for p in placed
        ):
            box[2:] += LETTER[1] / 2
        placed.append(box)
        axes.annotate(
            "\n".join(f" {line} " for line in lines),
            (start, 1 - box[2] if above else box[2]),
            xycoords="axes fraction",
            ha="left",
            va="top" if above else "bottom",
            fontsize=6,
            zorder=1,  # above the lines, below the dots
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0},
        )
    axes.set_xlabel("environment steps (millions)")
    axes.set_ylabel("return (points)")
    figure.legend(loc="outside upper left", ncols=3, fontsize=6, columnspacing=1, handlelength=1.5)
    return figure


def _notes(card: Path) -> list[str]:
    if not card.exists():
        return []
    _, heading, text = card.read_text(encoding="utf-8").partition("\n## Notes\n")
    return ["", "## Notes", text.rstrip("\n")] if heading else []


def write_card(checkpoint: Path, log: Path) -> tuple[Path, Path]:
    """Write what a reader must know of a checkpoint beside it, and its run's learning curve.

    Args:
        checkpoint: its card's notes, if any, stay.
        log: the published run.

    Returns: the card and the picture.
    """
    agent, recording = load(checkpoint), read(log / "generations.mcap")
    tensors, state = read_tensors(log / "state.safetensors", STATE_FORMAT)
    picture = checkpoint.with_suffix(".png")
    settings = TrainSettings(**state["settings"])  # the agent's own may be older
    learning_curve(recording, agent.experiment, settings).savefig(
        picture, dpi=150, metadata={"Software": None}
    )
    experiment, m, cost = agent.experiment, agent.metadata, state["progress"]
    done = int(tensors["generation"])
    result = scores.score(checkpoint, experiment.name)
    error = 1.96 * result.std / np.sqrt(len(result.returns))
    paper_mean, paper_std = scores.paper()["table3"][experiment.name]
    kept = KEPT[settings.keep]
    defaults = {
        "population": (describe_schedule(settings.population, done), experiment.population),
        "rollouts per candidate": (describe_schedule(settings.rollouts, done), experiment.rollouts),
        "generations": (done, experiment.generations),
        "learning rate": (
            describe_schedule(settings.learning_rate, done),
            PUBLISHED.learning_rate,
        ),
        "σ decay per generation": (
            describe_schedule(settings.sigma_decay, done),
            PUBLISHED.sigma_decay,
        ),
        "evaluated every ... generations": (
            _in_parts(recording, "evaluate_every"),
            TrainSettings.evaluate_every,
        ),
        "evaluation episodes": (
            _in_parts(recording, "evaluation_episodes", {None: "population × rollouts"}),
            experiment.population * experiment.rollouts,
        ),
        "evaluated agent": (_in_parts(recording, "keep", KEPT), KEPT["best"]),
    }
    sigma_start = settings.reinforce.sigma_start
    if sigma_start != PUBLISHED.sigma_start:
        defaults["σ at the start"] = (f"{sigma_start:g}", f"{PUBLISHED.sigma_start:g}")
    for name, words in (
        ("weight_decay", "weight decay"),
        ("decoupled_weight_decay", "decoupled weight decay (AdamW)"),
    ):
        schedule, published = getattr(settings, name), getattr(PUBLISHED, name)
        if schedule != ((0, published),):
            defaults[words] = (describe_schedule(schedule, done), published)
    if settings.shaped_rewards != TrainSettings.shaped_rewards:
        defaults["shaped rewards"] = (describe_schedule(settings.shaped_rewards, done), 1)
    lines = [
        f"# {experiment.title}, seed {settings.seed}",
        "",
        f"({experiment.letter}) of Table 3; `{checkpoint.name}`, sha256 {file_hash(checkpoint)}.",
        "",
        f"**Score** {result.mean:.1f} ± {result.std:.1f} over 100 rollouts on the reference "
        f"environment (95 % interval of the mean {result.mean - error:.1f} to "
        f"{result.mean + error:.1f}; evaluation seed 0). The paper's ten runs: {paper_mean} ± "
        f"{paper_std}.",
        "",
        f"**Cost** {cost['total_steps']:,} environment steps, {cost['cpu_seconds'] / 3600:.2f} "
        f"core-hours, {cost['seconds'] / 3600:.2f} hours of wall time on "
        f"{recording.metadata['host']}. The kept agent is of generation {m['generation']}, after "
        f"{m['environment_steps']:,} steps.",
        "",
        f"![Learning curve]({checkpoint.stem}.png)",
        "",
        "| setting | this run | the paper, its code |",
        "|---|---|---|",
        *(f"| {name} | {ours} | {theirs} |" for name, (ours, theirs) in defaults.items()),
        "",
        f"Kept: the {kept} with the best evaluation during training "
        f"({m['score']:.1f} over {m['score_episodes']} episodes"
        + (", with the reward for smaller legs)." if experiment.leg_area_reward else ")."),
    ]
    if agent.design is not None:
        body = experiment.body.design
        lines += ["", f"| part | % of the original | {body.unit} |", "|---|---|---|"]
        lines += [
            f"| {name} | {100 * scale:.0f} | {size:.3f} |"
            for name, scale, size in zip(
                body.names, agent.design, body.dimensions(agent.design), strict=True
            )
        ]
    card = checkpoint.with_suffix(".md")
    lines += _notes(card)
    card.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return card, picture


if __name__ == "__main__":
    main()
