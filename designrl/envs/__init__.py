"""Gymnasium environments whose body is a design; importing this package registers them."""

from functools import partial

import gymnasium
import numpy as np

from designrl.bodies.walker import is_closest_lidar, leg_area_reward_factor
from designrl.engine import Task


def _ones(scales: np.ndarray) -> np.ndarray:
    return np.ones(len(scales))


def _walker_task(hardcore: bool, steps: int, lidar: str = "v2", leg_area_reward: bool = False):
    flags = {"hardcore": hardcore, "closest_hits": is_closest_lidar(lidar)}
    task = Task("walker", tuple(name for name, on in flags.items() if on), steps)
    return task, leg_area_reward_factor if leg_area_reward else _ones


def _ant_task(max_episode_steps: int = 1000, **others):
    return None if others else (Task("ant", (), max_episode_steps), _ones)


# What the compiled engine has a task for.
_ENGINE_TASKS = {}
# Of these, the ones whose bits hang on what is installed: the ant's on the version of Bullet and on
# the C library's sine. Before the engine is used, it has to show that they are the reference's.
ENGINE_ON_TRIAL = {"designrl/Ant-v0"}

# Time limits of the 2018 environments, in steps.
for _id, _hardcore, _steps in (
    ("designrl/BipedalWalker-v0", False, 1600),
    ("designrl/BipedalWalkerHardcore-v0", True, 2000),
):
    _ENGINE_TASKS[_id] = partial(_walker_task, _hardcore, _steps)
    gymnasium.register(
        _id,
        entry_point="designrl.envs.walker:Walker",
        kwargs={"hardcore": _hardcore},
        max_episode_steps=_steps,
    )
_ENGINE_TASKS["designrl/Ant-v0"] = _ant_task
gymnasium.register("designrl/Ant-v0", entry_point="designrl.envs.ant:Ant", max_episode_steps=1000)


def engine_task(env_id: str, **kwargs):
    """What the compiled engine runs for an environment with these keywords.

    Returns: the engine's `Task`, and a function from scales (N, D) to factors (N,) of all rewards
        but a fall's; None where the engine has no such task.

    Raises:
        InputError: a keyword's value that the environment would refuse.
    """
    make = _ENGINE_TASKS.get(env_id)
    return make(**kwargs) if make else None
