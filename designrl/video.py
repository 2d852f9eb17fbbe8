"""Videos of a rollout, and of how body and gait came about over a run: .mp4, .gif or .webp.

record_video(agent, "walk.mp4", seed=0)
evolution_video("runs/biped-morphology/seed0", "evolution.mp4")
"""

import io
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path

import gymnasium
import numpy as np

from designrl.design import changes_in_words
from designrl.errors import InputError, optional
from designrl.experiments import get_experiment
from designrl.files import require_new, write_atomically
from designrl.policy import Agent
from designrl.recording import Recording, read

with optional("films", "view"):
    from PIL import Image, ImageDraw, ImageFont

SUFFIXES = (".mp4", ".gif", ".webp")
EVERY = 2  # steps from one picture to the next
STAGES, STAGE_SECONDS = 10, 6.0  # of an evolution: agents shown, and s of each at most
BAR = 0.065  # height of a caption by its width
INK, PAPER, MARK = (35, 35, 45), (245, 245, 250), (213, 94, 0)


def check_target(path: str | Path) -> None:
    """Raise InputError where no video can be written under that name, before any work is done."""
    suffix = Path(path).suffix
    if suffix not in SUFFIXES:
        raise InputError(f"{path} is no video; give it a name in {', '.join(SUFFIXES)}")
    require_new(path)
    if suffix == ".mp4":
        _av()


def record_video(
    agent: Agent,
    path: str | Path,
    seed: int,
    progress: Callable[[int], None] = lambda count: None,
    design=None,
) -> float:
    """Film one episode in real time.

    Args:
        path: the file to write.
        seed: of the environment and of the policy's noise.
        progress: called with 1 after each picture.
        design: the body to walk with, as `Agent.body_with` takes it; None: the agent's own.

    Returns: the score.

    Raises:
        InputError: another suffix than SUFFIXES, a file that exists or cannot be written, an
            environment that draws no pictures, no PyAV for an .mp4, or no design of the body.
    """
    check_target(path)
    score, scales = 0.0, agent.body_with(design)
    changes = changes_in_words(agent.experiment.body.design.changes(agent.scales, scales))
    title = ", ".join(filter(None, (name_of(agent), changes)))

    def frames() -> Iterator[Image.Image]:
        nonlocal score
        for picture, seconds, score in film(agent, seed, scales):  # noqa: B007 (it is returned)
            yield captioned(picture, title, f"{seconds:.1f} s: {score:.1f} points")
            progress(1)

    write_video(path, frames(), agent)
    return score


def evolution_video(
    run: str | Path, path: str | Path, progress: Callable[[int], None] = lambda count: None
) -> None:
    """Write the film that `evolution` gives.

    Args:
        run: its folder, or its recording.
        path: the file to write.
        progress: called with 1 after each of the STAGES.

    Raises:
        InputError: as `record_video` and `evolution`.
    """
    check_target(path)
    agent, pictures = evolution(run, STAGE_SECONDS, progress)
    write_video(path, pictures, agent)


def evolution(
    run: str | Path,
    seconds: float,
    progress: Callable[[int], None] = lambda count: None,
) -> tuple[Agent, Iterator[Image.Image]]:
    """The means of a run's search distribution, from its first generation to its last.

    The stages divide the way that generations and scores have gone into equal parts. Each is an
    episode of the same seed, up to so many seconds of it.

    Returns: the first stage's agent, and the pictures of all.

    Raises:
        InputError: no run with recorded distributions.
    """
    recording = read(run)
    if recording.kind != "run" or not recording.topics.get("/distribution"):
        raise InputError(f"{recording.path} holds no distributions of a run; name a run's folder")
    experiment = get_experiment(recording.metadata["experiment"])
    held = recording.array("/distribution", "generation")
    parameters = recording.array("/distribution", "mu")
    generations, scores = _curve(recording)
    title = f"{experiment.name} seed {recording.metadata.get('seed', '?')}"
    space = experiment.space(recording.about("limits"))
    agents = [
        (held[i], Agent(experiment, parameters[i], space=space))
        for i in _stages(held, generations, scores)
    ]

    def frames() -> Iterator[Image.Image]:
        for generation, agent in agents:
            for picture, now, score in film(agent, seed=0):
                if now > seconds:
                    break
                about = f"generation {generation}: {score:.1f} points"
                strip = _strip(picture.shape[1], generations, scores, generation)
                yield _stack(captioned(picture, title, about), strip)
            progress(1)

    return agents[0][1], frames()


def film(agent: Agent, seed: int, design=None) -> Iterator[tuple[np.ndarray, float, float]]:
    """Pictures (H, W, 3) of an episode, at s of its time, with the score so far.

    Raises:
        InputError: the environment draws none.
    """
    env_id, body, score = agent.experiment.env_id, agent.experiment.body, 0.0
    with closing(gymnasium.make(env_id, disable_env_checker=True)) as env:
        if "rgb_array" not in (env.metadata.get("render_modes") or ()):
            raise InputError(
                f"{env_id} draws no pictures, as its render_modes have no rgb_array; without a "
                "video, an .mcap shows its body"
            )
    kwargs = {"render_mode": "rgb_array", **agent.env_kwargs}
    env = gymnasium.make(env_id, disable_env_checker=True, **kwargs)
    try:
        for step in agent.play(env, seed, design):
            score += step.reward
            if step.t % EVERY == 0 or step.terminated or step.truncated:
                yield body.picture(env.unwrapped), (step.t + 1) * body.time_step, score
    finally:
        env.close()


def name_of(agent: Agent) -> str:
    """Experiment and seed."""
    seed = agent.metadata.get("seed")
    return agent.experiment.name + (f" seed {seed}" if seed is not None else "")


def captioned(picture, left: str, right: str) -> Image.Image:
    """A picture under a bar with text at its left and its right end."""
    picture = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    bar = Image.new("RGB", (picture.width, 2 * round(BAR * picture.width / 2)), INK)
    draw, middle = ImageDraw.Draw(bar), bar.height / 2
    size, space = 0.55 * bar.height, bar.height / 4
    # As wide as its numbers may become: letters must not shrink from one picture to the next.
    widest = left + "  " + re.sub(r"-?[\d.]+", "0000.0", right)
    while draw.textlength(widest, _font(size)) > bar.width - 2 * space:
        size *= 0.95
    draw.text((space, middle), left, PAPER, _font(size), "lm")
    draw.text((bar.width - space, middle), right, PAPER, _font(size), "rm")
    return _stack(bar, picture)


def _font(size: float) -> ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)


def _stack(above: Image.Image, below: Image.Image) -> Image.Image:
    image = Image.new("RGB", (above.width, above.height + below.height))
    image.paste(above, (0, 0))
    image.paste(below, (0, above.height))
    return image


# -------------------------------------------------------------------------- a run's learning


def _curve(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Generations and scores of a run's evaluations; without two of them, of its population."""
    topic = "/evaluation" if recording.topics.get("/evaluation", 0) > 1 else "/summary"
    return recording.array(topic, "generation"), recording.array(topic, "mean")


def _stages(held: np.ndarray, generations: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Which of the held generations to show: STAGES of them or fewer, as indices."""
    best = np.maximum.accumulate(np.interp(held, generations, scores))
    way = [values - values[0] for values in (held.astype(float), best)]
    way = sum(values / max(values[-1], 1e-9) for values in way)
    marks = np.linspace(0, way[-1], STAGES)
    return np.unique(np.abs(way - marks[:, None]).argmin(axis=1))


def _strip(width: int, generations, scores, now: int) -> Image.Image:
    """The learning curve as a strip, with a mark at a generation."""
    height, edge = 2 * (width // 16), 10  # even, for .mp4
    image = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(image)
    low, high = scores.min(), max(scores.max(), scores.min() + 1e-9)

    def place(generation, score) -> tuple[float, float]:
        x = edge + (width - 2 * edge) * generation / max(1, generations[-1])
        return float(x), float(height - edge - (height - 2 * edge) * (score - low) / (high - low))

    line = [place(g, s) for g, s in zip(generations.tolist(), scores.tolist(), strict=True)]
    draw.line(line, INK, 2)
    x, y = place(min(now, generations[-1]), np.interp(now, generations, scores))
    draw.line([(x, 0), (x, height)], MARK, 1)
    draw.ellipse([x - 5, y - 5, x + 5, y + 5], MARK)
    return image


# ------------------------------------------------------------------------------------ files


def write_video(
    path: str | Path, frames: Iterable[Image.Image], agent: Agent, every: int = EVERY
) -> None:
    """Write pictures of every so-many-th step as a video in real time; .gif and .webp loop.

    A .gif counts in hundredths of a second: an ant's is a tenth faster than real time.
    """
    seconds = every * agent.experiment.body.time_step
    data = io.BytesIO()
    if Path(path).suffix == ".mp4":
        _write_mp4(data, frames, seconds)
    else:
        kind = Path(path).suffix[1:].upper()
        if kind == "GIF":  # Pillow's own choice of 256 colours takes most of the time
            frames = (image.quantize(method=Image.Quantize.FASTOCTREE) for image in frames)
        rest = iter(frames)
        first = next(rest)
        how = {"loop": 0, "duration": round(1000 * seconds), "quality": 40, "method": 2}
        first.save(data, kind, save_all=True, append_images=rest, **how)
    write_atomically(path, data.getvalue())


def _write_mp4(data: io.BytesIO, frames: Iterable[Image.Image], seconds: float) -> None:
    av, stream = _av(), None
    with av.open(data, "w", format="mp4") as container:
        for image in frames:
            if stream is None:
                stream = container.add_stream("libx264", rate=round(1 / seconds))
                stream.width, stream.height, stream.pix_fmt = *image.size, "yuv420p"
            container.mux(stream.encode(av.VideoFrame.from_image(image)))
        container.mux(stream.encode())


def _av():
    with optional("PyAV (for .mp4, not for .gif or .webp)", "video", "pip install av"):
        import av
    return av
