"""Makes roboschool_ant.json: the first steps of ants in Roboschool itself, for tests/test_ant.py.

    QT_QPA_PLATFORM=offscreen python3.6 make_roboschool_ant.py bodies.json roboschool_ant.json

Needs Python 3.6, gym 0.10.5, roboschool 1.0.49 and numpy, of which a tool of 2018 takes what there
was then; so it reads the bodies as MJCF text from bodies.json: {name: [scales, text of mjcf()]}.
Where several contacts act in one substep, the result depends on their order, which Roboschool
does not keep from run to run. Each episode is therefore run REPEATS times and kept until two feet
touch at once or the runs disagree.
"""

import json
import os
import sys
import tempfile

import gym
import numpy as np
import roboschool  # noqa: F401 (registers the environment)

STEPS = 40
REPEATS = 8
SEEDS = 40  # tried per body
EPISODES = 3  # kept per body: such that a foot touches in them
AGREE = 1e-6


class Angles:
    """Stands in for the environment's random numbers: the angles at the start."""

    def __init__(self, angles):
        self.angles = list(angles)

    def uniform(self, low, high):
        return self.angles.pop(0)


def run(env, angles, actions):
    env.np_random = Angles(angles)
    rows = [list(env.reset()) + [0.0]]
    for action in actions:
        observation, reward, done, _ = env.step(action)
        rows.append(list(observation) + [reward])
        if done or sum(len(part.contact_list()) for part in env.parts.values()) > 1:
            rows.pop()
            break
    return np.array(rows)


def main(bodies_file, out_file):
    env = gym.make("RoboschoolAnt-v1").unwrapped
    legs = ("front left", "front right", "back left", "back right")
    env.foot_list = [leg + " bottom" for leg in legs]
    episodes = []
    with open(bodies_file) as file:
        bodies = json.load(file)
    for name, (scales, text) in sorted(bodies.items()):
        with tempfile.NamedTemporaryFile("w", suffix=".xml", delete=False) as file:
            file.write(text)
        env.model_xml = file.name
        kept = 0
        for seed in range(SEEDS):
            if kept == EPISODES:
                break
            rng = np.random.RandomState(seed)
            angles = rng.uniform(-0.1, 0.1, 8).astype(np.float32).astype(float)
            actions = np.repeat(rng.uniform(-1, 1, (STEPS // 8, 8)), 8, axis=0).round(3)
            runs = [run(env, angles, actions) for _ in range(REPEATS)]
            steps = min(map(len, runs))
            spread = np.ptp([rows[:steps] for rows in runs], axis=0).max(axis=1)
            agreed = int(np.argmax(spread > AGREE)) if (spread > AGREE).any() else steps
            touched = int(runs[0][:agreed, 24:28].any(axis=1).sum())
            if not touched:
                continue
            kept += 1
            print(name, seed, "rows:", agreed, "after a contact:", touched)
            episodes.append(
                {
                    "body": name,
                    "scales": scales,
                    "angles": angles.tolist(),
                    "actions": actions[: agreed - 1].tolist(),
                    "observations": runs[0][:agreed, :-1].round(6).tolist(),
                    "rewards": runs[0][1:agreed, -1].round(6).tolist(),
                }
            )
        os.unlink(file.name)
    with open(out_file, "w") as file:
        file.write("[\n" + ",\n".join(map(json.dumps, episodes)) + "\n]\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
