"""Gymnasium environments whose body is a design; importing this package registers them."""

import hashlib
from contextlib import closing
from functools import partial
from importlib.util import find_spec

import gymnasium
import numpy as np

from designrl import engine
from designrl.bodies.walker import is_closest_lidar, leg_area_reward_factor
from designrl.engine import Task
from designrl.engine.stepper import DISABLED, Stepper

# The environments whose bits in the engine hang on what is installed: the ant's on the version of
# Bullet and on the C library's sine. Before the engine is used, it has to show that they are the
# reference's; where it has the portable lanes alone, its bits are x86-64's, whatever is installed.
# Where the package that the reference needs is not installed, what the reference gave elsewhere is
# in its place, as a hash.
_ON_TRIAL = {
    "designrl/Ant-v0": (
        "pybullet",
        "4c9e030df25cb2f0073338a679b37cdb7b574d8ac47f2bbda71ba1149b45323a",
    )
}
_trials: dict[str, str | None] = {}  # of each, once in a process
TRIAL_STEPS = 100


def walker_task(
    hardcore: bool,
    max_episode_steps: int,
    lidar: str = "v2",
    leg_area_reward: bool = False,
    **others,
):
    """`engine_task` of a walker."""
    if others:
        return None
    flags = {"hardcore": hardcore, "closest_hits": is_closest_lidar(lidar)}
    task = Task("walker", tuple(name for name, on in flags.items() if on), max_episode_steps)
    return task, leg_area_reward_factor if leg_area_reward else None


def _ant_task(max_episode_steps: int = 1000, **others):
    return None if others else (Task("ant", (), max_episode_steps), None)


_ENGINE_TASKS = {}  # what the compiled engine has a task for

# Time limits of the 2018 environments, in steps.
for _id, _hardcore, _steps in (
    ("designrl/BipedalWalker-v0", False, 1600),
    ("designrl/BipedalWalkerHardcore-v0", True, 2000),
):
    _ENGINE_TASKS[_id] = partial(walker_task, hardcore=_hardcore, max_episode_steps=_steps)
    gymnasium.register(
        _id,
        entry_point="designrl.envs.walker:Walker",
        vector_entry_point="designrl.envs.walker:VectorWalker",
        kwargs={"hardcore": _hardcore},
        max_episode_steps=_steps,
    )
_ENGINE_TASKS["designrl/Ant-v0"] = _ant_task
gymnasium.register(
    "designrl/Ant-v0",
    entry_point="designrl.envs.ant:Ant",
    vector_entry_point="designrl.envs.ant:VectorAnt",
    max_episode_steps=1000,
)


def engine_task(env_id: str, **kwargs):
    """What the compiled engine runs for an environment with these keywords.

    Returns: the engine's `Task`, and a function from scales (N, D) to factors (N,) of all rewards
        but a fall's, if there are any; None where the engine has no such task.

    Raises:
        InputError: a keyword's value that the environment would refuse.
    """
    make = _ENGINE_TASKS.get(env_id)
    return make(**kwargs) if make else None


def engine_reason(env_id: str) -> str | None:
    """Why the engine cannot run an environment that it has a task for, as a clause, or None."""
    reason = engine.missing_reason()
    if reason or env_id not in _ON_TRIAL or engine.instruction_sets() == ["portable"]:
        return reason
    if env_id not in _trials:
        _trials[env_id] = _try_engine(env_id)
    return _trials[env_id]


def _try_engine(env_id: str) -> str | None:
    # Contacts carry a difference in the last bit of anything into the rewards within a few steps.
    task, _ = engine_task(env_id)
    package, elsewhere = _ON_TRIAL[env_id]
    rng = np.random.default_rng(0)
    with Stepper(task, 1, DISABLED) as stepper:
        design = rng.uniform(0.75, 1.25, (1, stepper.dimensions))
        actions = rng.uniform(-1.0, 1.0, (TRIAL_STEPS, stepper.actions))
        played = stepper.reset(design, [0]).tobytes()
        for action in actions:
            observation, reward, *_ = stepper.step(action[None])
            played += observation.tobytes() + reward.tobytes()
    if find_spec(package):
        with closing(gymnasium.make(env_id, disable_env_checker=True)) as env:
            expected = env.reset(seed=0, options={"design": design[0]})[0].tobytes()
            for action in actions:
                observation, reward, *_ = env.step(action)
                expected += observation.tobytes() + np.float64(reward).tobytes()
        same, here = played == expected, "is installed here"
    else:
        same, here = hashlib.sha256(played).hexdigest() == elsewhere, "is here"
    if same:
        return None
    return (
        f"the compiled engine's {env_id} is not the reference's to the bit with what {here} (it "
        "was written for PyBullet 3.2.7 on glibc)"
    )
