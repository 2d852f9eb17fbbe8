"""Short looping videos of each experiment's best agent, for the README and the page.

    make gallery

Writes paper/gallery/EXPERIMENT.webp, a stretch of one typical rollout, and for the walkers on
hardcore ground fall-EXPERIMENT.webp, the end of the rollout with the lowest score; experiments
without a checkpoint are skipped. blooper-EXPERIMENT.webp are of runs whose bodies have other limits
than the paper's, a typical rollout to 8 s. learning-EXPERIMENT.webp shows body and gait come about,
where the recording of a run has enough distributions. Not part of `make reproduce`: nothing is
read from it.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

from PIL import Image
from tqdm import tqdm

from designrl.bodies.ant import ANT
from designrl.evaluation import episode_seeds
from designrl.policy import Agent
from designrl.recording import read
from designrl.video import EVERY, STAGES, captioned, evolution, film, write_video
from reproduce.drawing import typical_seed
from reproduce.paths import EIGHT, bloopers, recording_of, shown
from reproduce.program import program
from reproduce.publish import most_recorded
from reproduce.scores import EPISODES, SEED, Score, score, usable
from reproduce.sources import Sources
from reproduce.tables import mean_and_std

WIDTH = 400  # pixels
FIRST, LAST = 1.2, 3.6  # s of the rollout
LAST_OF_BLOOPER = 8.0  # s: long legs fall slowly
STAGE = 1.8  # s of each stage of learning
HELD = 15  # pictures that a fall's last one stays


def walk(s: Score, last: float = LAST) -> Iterator[Image.Image]:
    """Pictures of a typical rollout to so many s, with the agent's name and score."""
    for picture, seconds, _ in film(s.agent, typical_seed(s)):
        if seconds > last:
            return
        if seconds >= FIRST:
            yield drawn(picture, s, mean_and_std(s.mean, s.std))


def fall(s: Score) -> Iterator[Image.Image]:
    """Pictures of the end of the rollout with the lowest score."""
    seed = int(episode_seeds(SEED, EPISODES)[s.returns.argmin()])
    count = round((LAST - FIRST) / (EVERY * s.agent.experiment.body.time_step))
    pictures = [picture for picture, _, _ in deque(film(s.agent, seed), maxlen=count)]
    for picture in pictures + HELD * pictures[-1:]:
        yield drawn(picture, s, f"{s.returns.min():.0f}, its lowest of {EPISODES}")


def small(image: Image.Image) -> Image.Image:
    """An image, WIDTH wide."""
    size = WIDTH, round(image.height * WIDTH / image.width)
    return image.resize(size, Image.Resampling.LANCZOS)


def drawn(picture, s: Score, points: str) -> Image.Image:
    """A picture, small, with the agent's name and its points."""
    name = f"{s.agent.experiment.title}, {s.run}"
    return captioned(small(Image.fromarray(picture)), name, points)


def learn(sources: Sources, name: str) -> None:
    """Write how body and gait came about, where they are learned and recorded often enough."""
    log = recording_of(Path(name, most_recorded(EIGHT[name])))
    if not (EIGHT[name].learns_design and log.exists()):
        return
    if read(log).topics.get("/distribution", 0) < STAGES:
        return
    agent, pictures = evolution(log, STAGE)
    thin = 2 if agent.experiment.body is ANT else 1  # its ground fills the picture: large files
    frames = islice(map(small, pictures), None, None, thin)
    write(sources.folder / f"gallery/learning-{name}.webp", frames, agent, thin * EVERY)


def write(path: Path, frames: Iterable[Image.Image], agent: Agent, every: int = EVERY) -> None:
    """Write a video, and say so."""
    write_video(path, frames, agent, every)
    tqdm.write(f"{shown(path)}: {path.stat().st_size / 1024:.0f} kB")


def main() -> None:
    """Write the videos of each experiment that has a checkpoint."""
    sources = Sources.asked()
    with tqdm(EIGHT, unit="video") as bar:
        for name in bar:
            bar.set_postfix_str(name)
            if s := sources.representative(name):
                write(sources.folder / f"gallery/{name}.webp", walk(s), s.agent)
                if "hardcore" in name:
                    write(sources.folder / f"gallery/fall-{name}.webp", fall(s), s.agent)
            learn(sources, name)
        for s in usable(score(path, path.parent.name, sources.backend) for path in bloopers()):
            target = sources.folder / f"gallery/blooper-{s.agent.experiment.name}.webp"
            write(target, walk(s, LAST_OF_BLOOPER), s.agent)


if __name__ == "__main__":
    with program("gallery"):
        main()
