"""The vector environments for Stable-Baselines3 (the extra sb3; in a clone, `make setup-train`).

    from designrl.envs.sb3 import EngineVecEnv

    env = EngineVecEnv("designrl/BipedalWalkerHardcore-v0", num_envs=32, design=scales)
    PPO("MlpPolicy", env).learn(1_000_000)

Not imported with the package. `VecMonitor` around it records returns, `VecNormalize` normalises.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from designrl.envs.inputs import checked_options
from designrl.envs.tasks import WORLDS
from designrl.errors import InputError, optional
from designrl.numeric import whole_number

with optional("Stable-Baselines3", "sb3", "make setup-train"):
    from stable_baselines3.common.vec_env import VecEnv


class EngineVecEnv(VecEnv):
    """N environments of one kind, side by side in the compiled engine.

    Outputs have the bits of `DummyVecEnv` over single environments. Episodes begin anew as
    Stable-Baselines3 has it, in the step in which the one before ends. `infos[i]` has
    "reward_terms" and "TimeLimit.truncated", and then "terminal_observation".

    Args:
        env_id: a designrl environment.
        num_envs: N.
        seed: of the first reset; environment i gets seed + i. `seed()` sets another.
        kwargs: further ones of `gymnasium.make_vec`: design, lidar, threads, flat_info, ...

    Attributes:
        env: the `designrl.envs.vector.EngineVectorEnv`.

    Raises:
        InputError (a ValueError): as the vector environment does.
    """

    def __init__(self, env_id: str, num_envs: int, seed: int | None = None, **kwargs):
        if env_id not in WORLDS or "autoreset_mode" in kwargs:
            raise InputError(
                f"EngineVecEnv is for {', '.join(WORLDS)}, in Stable-Baselines3's own mode of "
                f"reset; got {env_id!r}" + ", autoreset_mode" * ("autoreset_mode" in kwargs)
            )
        if reason := WORLDS[env_id].engine_reason():
            raise InputError(
                f"{reason}; stable_baselines3's DummyVecEnv([lambda: gymnasium.make({env_id!r})] * "
                f"{num_envs}) runs single ones, with the same results"
            )
        self.env = gymnasium.make_vec(
            env_id,
            num_envs,
            vectorization_mode="vector_entry_point",
            autoreset_mode=AutoresetMode.SAME_STEP,
            **kwargs,
        )
        spaces = self.env.single_observation_space, self.env.single_action_space
        super().__init__(num_envs, *spaces)
        if seed is not None:
            self.seed(seed)

    def reset(self) -> np.ndarray:
        """Start all episodes: with the seeds and designs of `seed()` and `set_options()` before.

        Returns: (N, O) observations.
        """
        designs = list(self.env.design)
        for i, options in enumerate(self._options):
            design = checked_options(options, "design").get("design")
            if design is not None:
                designs[i] = design
        observations, _ = self.env.reset(seed=self._seeds, options={"design": designs})
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, rewards, terminated, truncated, info = self.env.step(self._actions)
        ended = terminated | truncated
        infos = self._terms(info, ended)
        for each, cut in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            each["TimeLimit.truncated"] = cut
        for i in np.flatnonzero(ended):
            infos[i]["terminal_observation"] = info["final_obs"][i]
        return observations, rewards.astype(np.float32), ended, infos

    def _terms(self, info: dict, ended: np.ndarray) -> list[dict[str, Any]]:
        """Each environment's info with its reward terms."""
        flat, names = self.env.flat_info, self.env.reward_terms
        found = info, info.get("final_info", {})
        if flat:
            names = [f"reward_{name}" for name in names]
        else:
            found = (each.get("reward_terms", {}) for each in found)
        live, final = found
        none = np.zeros(self.num_envs)
        columns = [
            np.where(ended, final.get(name, none), live.get(name, none)).tolist() for name in names
        ]
        rows = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
        return rows if flat else [{"reward_terms": row} for row in rows]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """The seeds of the next reset, from this one on; None: from a random one."""
        return super().seed(None if seed is None else whole_number("seed", seed, 0))

    def close(self) -> None:
        self.env.close()

    # What asks for single environments gets the vector environment's: they differ in design alone.

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        found = getattr(self.env, attr_name)
        each = attr_name == "design"
        return [found[i] if each else found for i in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        raise InputError(f"{attr_name!r} cannot be set: the environments are in the engine")

    def env_method(self, method_name: str, *args, indices=None, **kwargs) -> list[Any]:
        raise InputError(f"{method_name}() cannot be called: the environments are in the engine")

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
