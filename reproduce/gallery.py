"""Short looping videos of each experiment's best agent, for the README.

    make gallery

Writes paper/gallery/EXPERIMENT.webp, a stretch of one typical rollout; experiments without a
checkpoint are skipped. Not part of `make reproduce`: nothing is read from it.
"""

from collections.abc import Iterator
from pathlib import Path

from PIL import Image
from tqdm import tqdm

from designrl.video import captioned, film, write_video
from reproduce.drawing import typical_seed
from reproduce.paths import EIGHT, shown
from reproduce.program import program
from reproduce.scores import Score
from reproduce.sources import Sources
from reproduce.tables import mean_and_std

WIDTH = 400  # pixels
FIRST, LAST = 1.2, 3.6  # s of the rollout


def frames(s: Score) -> Iterator[Image.Image]:
    """The pictures, with the agent's name and score."""
    for picture, seconds, _ in film(s.agent, typical_seed(s)):
        if seconds > LAST:
            return
        if seconds >= FIRST:
            image = Image.fromarray(picture)
            size = WIDTH, round(image.height * WIDTH / image.width)
            name = f"{s.agent.experiment.title}, {s.run}"
            score = mean_and_std(s.mean, s.std)
            yield captioned(image.resize(size, Image.Resampling.LANCZOS), name, score)


def write(s: Score, folder: Path) -> Path:
    """Write an agent's video to a folder; returns its path."""
    path = folder / f"{s.agent.experiment.name}.webp"
    write_video(path, frames(s), s.agent)
    return path


def main() -> None:
    """Write a video per experiment that has a checkpoint."""
    sources = Sources.asked()
    with tqdm(EIGHT, unit="video") as bar:
        for name in bar:
            bar.set_postfix_str(name)
            if s := sources.representative(name):
                path = write(s, sources.folder / "gallery")
                tqdm.write(f"{shown(path)}: {path.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    with program("gallery"):
        main()
