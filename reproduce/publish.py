"""Publish a training run: its checkpoint and card to pretrained/, its recordings to logs/.

    designrl publish runs/biped-morphology/seed0 --name seed0

Published are pretrained/EXPERIMENT/seedK.safetensors with a card (.md) and a learning curve (.png),
and in logs/EXPERIMENT/seedK/ the recording with generations dropped (never rounded) and the first
steps of a rollout of the agent; all that the run's folder holds is not needed again.
"""

import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tabulate import tabulate

from designrl.compare import rendered
from designrl.errors import InputError
from designrl.experiments import Experiment
from designrl.files import file_hash, write_atomically
from designrl.names import load
from designrl.recording import record_rollout, thin
from designrl.recording.run import KEPT
from designrl.settings import TrainSettings
from reproduce import curves, drawing, paths, scores
from reproduce.paths import EIGHT, paper, recording_of
from reproduce.runs import Run, read_published, read_run
from reproduce.scores import EPISODES, SEED, Score, rewards_small_legs
from reproduce.statistics import mean_interval

ROLLOUT_STEPS = 60  # recorded of the agent: enough to see its gait, small enough to commit
DISTRIBUTIONS = 20  # of one run of an experiment; others have three
# Which one, by letter; seed 0 of the others. Of older runs all but three were not kept.
MORE = {"a": "seed5", "b": "seed5", "f": "seed3", "g": "paper-seed1", "h": "seed3"}
# How names of runs begin -> the recipe of such a run, and what may differ from that.
KINDS = {
    "": ("ours", set()),
    "paper-": ("paper", set()),
    "blooper-": ("ours", {"design_form", "design_limit"}),
}
# Generations of a run at the paper's settings, by letter: as many as the paper's Figure 5 shows;
# elsewhere as many as the paper trained.
SHOWN = {"f": 8000, "g": 3000, "h": 3000}


def publish(run: Path, name: str, replace: bool = False) -> str:
    """Check the run, then write all that is published of it; returns what was written.

    Args:
        run: its folder.
        name: of the files: for a run of seed K "seedK" or "paper-seedK"; where its body has other
            limits than the paper's, "blooper-seedK".
        replace: also where another run of that name is published.

    Raises:
        InputError: the run is damaged, not of one of the paper's experiments or has other settings
            than its name says, or another one is published; nothing has been changed.
    """
    agent = load(run / "best.safetensors")
    if agent.experiment.name not in EIGHT:
        raise InputError(f"{run} is of {agent.experiment.name}; the paper's runs are published")
    recorded = read_run(run / "generations.mcap", agent.experiment.name, agent.metadata["seed"])
    published_scores()  # whatever is wrong with it is said before anything is written
    settings = TrainSettings(**agent.metadata["settings"])
    check_name(name, run, settings)
    if (done := int(recorded.generation[-1]) + 1) < settings.generations:
        raise InputError(f"{run} has {done} of {settings.generations} generations; train the rest")
    checkpoint = paths.ROOT / "pretrained" / agent.experiment.name / f"{name}.safetensors"
    content, log = (run / "best.safetensors").read_bytes(), recording_of(checkpoint).parent
    is_it = checkpoint.exists() and checkpoint.read_bytes() == content
    if not is_it and not replace and (checkpoint.exists() or log.exists()):
        there = checkpoint if checkpoint.exists() else log
        raise InputError(f"{there} is of another run, which stays; train one with another seed")
    rollout = Path("rollouts", f"generation{agent.metadata['generation']:05d}.mcap")
    log.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=log.parent) as folder:  # whole, or not at all
        new = Path(folder, "new")
        new.mkdir()
        most = messages_kept(agent.experiment, name)
        thin(run / "generations.mcap", new / "generations.mcap", most)
        whole = name in ("seed0", most_recorded(agent.experiment))
        record_rollout(agent, new / rollout, SEED, steps=None if whole else ROLLOUT_STEPS)
        write_atomically(checkpoint, content)
        shutil.rmtree(log, ignore_errors=True)
        new.rename(log)
    kept = read_published(recording_of(checkpoint))
    s = scores.score(checkpoint, agent.experiment.name)
    curve = rendered(learning_curve(kept, s), "png", dpi=100)
    write_atomically(checkpoint.with_suffix(".png"), curve)
    write_atomically(checkpoint.with_suffix(".md"), card(s, kept).encode())
    add_to_index(s)
    return f"{checkpoint}, its card, its curve and {log} written"


def messages_kept(experiment: Experiment, name: str) -> dict[str, int]:
    """Of each topic of a run's recording, how many messages are published at most."""
    more = name == most_recorded(experiment)
    return KEPT | ({"/distribution": DISTRIBUTIONS} if more else {})


def most_recorded(experiment: Experiment) -> str:
    """Name of the run of which most is published."""
    return MORE.get(experiment.letter, "seed0")


def check_name(name: str, run: Path, settings: TrainSettings) -> None:
    """Raise InputError where a run of these settings is not to have that name; see KINDS."""
    kinds = ("blooper-",) if settings.design_form or settings.design_limit else ("", "paper-")
    names = {f"{kind}seed{settings.seed}": kind for kind in kinds}
    if name not in names:
        why = "seed and its limits" if "blooper-" in kinds else "seed"
        raise InputError(f"{run} cannot be {name}; by its {why} it is {' or '.join(names)}")
    check_settings(name, run, settings, *KINDS[names[name]])


def settings_of(experiment: str, recipe: str, seed: int) -> TrainSettings:
    """Those of a recipe, which a run is published with; "paper" has the generations of SHOWN."""
    settings = TrainSettings.of(experiment, recipe, seed=seed)
    if recipe != "paper":
        return settings
    return replace(settings, generations=SHOWN.get(EIGHT[experiment].letter, settings.generations))


def check_settings(name: str, run: Path, settings: TrainSettings, recipe: str, free: set) -> None:
    """Raise InputError where settings are not those of a recipe, but for the free ones."""
    expected = vars(settings_of(settings.experiment, recipe, settings.seed))
    for setting, value in vars(settings).items():
        if value != expected[setting] and setting not in free:
            raise InputError(
                f"{run} cannot be {name}; such a run has {setting} = {expected[setting]!r}, by the "
                f"recipe {recipe!r}, and this one has {value!r}"
            )


def add_to_index(s: Score) -> None:
    """Write its score and the paper's to pretrained/index.json, for `designrl checkpoints`."""
    path, found = index_file(), published_scores()
    name = s.path.relative_to(path.parent).with_suffix("").as_posix()
    found[name] = {
        "mean": round(s.mean, 1),
        "std": round(s.std, 1),
        "episodes": len(s.returns),
    }
    if not paths.is_blooper(s.path):
        found[name]["paper"] = "{} ± {}".format(*paper()["table3"][s.path.parent.name])

    def place(name: str) -> tuple:
        experiment, run = name.split("/")
        return list(EIGHT).index(experiment), len(run), run

    index = {name: found[name] for name in sorted(found, key=place)}
    write_atomically(path, json.dumps(index, indent=1, ensure_ascii=False).encode() + b"\n")


def index_file() -> Path:
    """Where the scores of the published agents stand."""
    return paths.ROOT / "pretrained" / "index.json"


def published_scores() -> dict[str, dict]:
    """What the index says of each published agent.

    Raises:
        InputError: it names one of an experiment that is not the paper's.
    """
    path = index_file()
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if unknown := [name for name in found if name.partition("/")[0] not in EIGHT]:
        raise InputError(f"{path} names {unknown[0]}, of no experiment of the paper; take it out")
    return found


def learning_curve(run: Run, s: Score) -> Figure:
    """The population's return and the evaluated agents' scores over environment steps."""
    figure = Figure(figsize=(drawing.WIDTH, 2.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    curves.draw(left, right, curves.STEPS, [run], "this run", drawing.ORIGINAL)
    name = s.agent.experiment.name
    # The paper's number is without the factor for small legs, and of its own bodies.
    if not (rewards_small_legs(name) or paths.is_blooper(s.path)):
        mean, _ = paper()["table3"][name]
        right.axhline(mean, color=drawing.GREY, linestyle="--", label=f"the paper's mean: {mean}")
    curves.show_differences(right, name)
    for axes, label in zip((left, right), curves.axis_labels(name), strict=True):
        axes.set_xlabel(curves.STEPS)
        axes.set_ylabel(label)
    drawing.legend(figure, right, ncols=2)
    return figure


def card(s: Score, run: Run) -> str:
    """What a reader must know of a checkpoint: score, cost, curve, body, command, origin."""
    m, experiment, design = s.agent.metadata, s.agent.experiment, s.agent.experiment.design
    low, high = mean_interval(s.returns)
    mean, std = paper()["table3"][experiment.name]
    factor = ", with the reward for smaller legs" * rewards_small_legs(experiment.name)
    of, theirs = f"({experiment.letter}) of Table 3", f" The paper's ten runs: {mean} ± {std}."
    if paths.is_blooper(s.path):
        of, theirs = f"As ({experiment.letter}), in a body of other limits than the paper's", ""
    paragraphs = [
        f"# {experiment.title}, {s.run}",
        f"{of}; `{s.path.name}`, sha256 {s.sha256}.",
        f"**Score** {s.mean:.1f} ± {s.std:.1f} over {EPISODES} rollouts (95 % interval of "
        f"the mean {low:.1f} to {high:.1f}; median "
        f"{np.median(s.returns):.1f}, lowest {s.returns.min():.1f}, highest "
        f"{s.returns.max():.1f}).{theirs}",
        f"**Cost** {run.steps_with(s.agent):,} environment steps, {run.core_hours[-1]:.2f} "
        f"core-hours, {run.hours[-1]:.2f} hours, {run.host}. "
        f"Of {run.generation[-1] + 1:,} generations the agent after number {m['generation']:,} is "
        f"kept ({m['environment_steps']:,} steps): the one with the best evaluation during "
        f"training ({m['score']:.1f} over {m['score_episodes']} episodes{factor}).",
        f"![Learning curve]({s.path.stem}.png)",
    ]
    if design is not None:
        parts: dict[str, dict[str, str]] = {}  # "top leg 1" -> "width" -> text
        sizes = zip(s.agent.design, design.dimensions(s.agent.design), strict=True)
        for name, (scale, size) in zip(design.names, sizes, strict=True):
            part, _, side = name.rpartition(" ")
            parts.setdefault(part, {})[side] = f"{100 * scale:.0f} % ({size:.3g})"
        header = [f"% of the original ({design.unit})", *next(iter(parts.values()))]
        rows = [[part, *sides.values()] for part, sides in parts.items()]
        paragraphs.append(tabulate(rows, header, tablefmt="github", disable_numparse=True))
    command = TrainSettings(**m["settings"]).command()
    name = f"{experiment.name}/{s.path.stem}"
    evaluation = f"designrl evaluate {name} --episodes {EPISODES} --seed {SEED}"
    paragraphs.append(
        "**Commands** that trained it ([would they again?](../../docs/fidelity.md"
        "#do-the-published-runs-come-out-again)) and score it\n\n"
        f"```\n{command}\n{evaluation}\n```"
    )
    note = scores.scoring_note("engine")
    origin = f"**Origin of the score.** {note} Settings: `designrl info {name}`."
    if (log := recording_of(s.path)).exists():
        place = f"logs/{name}"
        origin += f" Recording: [{place}](../../{place}), sha256 {file_hash(log)}."
    paragraphs.append(origin)
    return "\n\n".join(paragraphs) + "\n"
