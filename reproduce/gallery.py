"""Short looping pictures of each experiment's best agent, for the README.

    make gallery

Writes paper/gallery/EXPERIMENT.webp, as the environments render one rollout; experiments without a
checkpoint are skipped. Not part of `make reproduce`: nothing is read from it.
"""

import io

import gymnasium
import numpy as np
from PIL import Image
from tqdm import tqdm

from designrl.experiments import EXPERIMENTS
from designrl.files import write_atomically
from reproduce import scores
from reproduce.drawing import typical_seed
from reproduce.scores import Score

WIDTH = 320  # pixels
FRAMES = 60
FIRST, EVERY = 60, 3  # steps: where the picture starts, and from one frame to the next


def rollout(s: Score) -> tuple[list[Image.Image], float]:
    """Pictures of a stretch of one typical rollout, and how many ms each is to be shown."""
    env_id = s.agent.experiment.env_id
    env = gymnasium.make(env_id, render_mode="rgb_array", disable_env_checker=True)
    frames = []
    for step in s.agent.play(env, typical_seed(s)):
        if step.t == FIRST + FRAMES * EVERY:
            break
        if step.t >= FIRST and (step.t - FIRST) % EVERY == 0:
            picture = Image.fromarray(np.ascontiguousarray(env.render()))
            height = round(picture.height * WIDTH / picture.width)
            frames.append(picture.resize((WIDTH, height), Image.Resampling.LANCZOS))
    env.close()
    return frames, 1000 * EVERY / env.metadata["render_fps"]


def main() -> None:
    """Write a picture per experiment that has a checkpoint."""
    with tqdm(EXPERIMENTS, unit="picture") as bar:
        for name in bar:
            bar.set_postfix_str(name)
            s = scores.representative(name)
            if s is None:
                continue
            frames, duration = rollout(s)
            data = io.BytesIO()
            how = {"duration": round(duration), "loop": 0, "quality": 40, "method": 4}
            frames[0].save(data, "WEBP", save_all=True, append_images=frames[1:], **how)
            path = scores.output_folder() / "gallery" / f"{name}.webp"
            write_atomically(path, data.getvalue())
            tqdm.write(f"{scores.shown(path)}: {path.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
