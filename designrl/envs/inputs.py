"""What `reset` and `step` take, and what they did: an episode can be saved and restored."""

import copy
from dataclasses import dataclass

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import EzPickle

from designrl.bodies import Body
from designrl.errors import InputError
from designrl.numeric import real_numbers, whole_number


def checked_options(options: dict | None, *names: str) -> dict:
    """The options of a `reset`, as a new dict.

    Raises:
        InputError: one that has none of these names, or no dict.
    """
    if not isinstance(options, dict | None):
        raise InputError(f"reset options are a dict, as {{{names[0]!r}: ...}}, or None")
    options = dict(options or {})
    if unknown := sorted(set(options) - set(names)):
        known = " and ".join(map(repr, names))
        raise InputError(f"unknown reset option {unknown[0]!r}; there is {known}")
    return options


@dataclass(frozen=True)
class EpisodeState:
    """How an episode of a single environment got where it is.

    Attributes:
        kind: of environment.
        random: its generator as `reset` found it, and as it is now.
        seed: the generator's.
        designs: (2, D) scales of the body, and of the one from the next reset on.
        actions: (steps, A) float64, as bytes.
        observation: the last one's bytes.
    """

    kind: str
    random: tuple[np.random.Generator, np.random.Generator]
    seed: int
    designs: np.ndarray
    actions: bytes
    observation: bytes


class HasDesign(EzPickle):
    """An environment with a `body`, in a design that is checked whenever it is set.

    Its `reward_weights` are those of reward terms that are not 1.

    An environment defines `_start_episode()`, which begins an episode in its `design` with its
    `np_random` and returns an observation, and `_advance(action)`, a step.

    Its constructor calls `EzPickle.__init__`, of which the design is the first argument and the
    render mode the last, and then `_set_design`.
    """

    body: Body
    reward_weights: dict[str, float]
    # (D,) that it was made with, or that `design` was set to: a choice, as an agent's reset is not.
    given_design: np.ndarray | None = None
    # Of the episode: the generator at its start, scales, actions' bytes, observation's bytes. None
    # before the first reset, and where one, or a step, did not come to its end.
    _episode: tuple | None = None

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Start an episode; `options={"design": scales}` changes the body from now on.

        Raises:
            InputError: another option, no design of the body, or a seed that is no whole number
                from 0 on.
        """
        seed = None if seed is None else whole_number("seed", seed, 0)
        if (design := checked_options(options, "design").get("design")) is not None:
            self._take_design(design)
        gymnasium.Env.reset(self, seed=seed)  # seeds the generator
        return self._begin(), {}

    def step(self, action):
        """One of the body's time steps; the reward is float64 whatever the action's type.

        Raises:
            InputError: an action that is not a finite number for each joint.
            gymnasium.error.ResetNeeded: there is no episode.
        """
        action = checked_action(action, *self.action_space.shape)
        if self._episode is None:
            raise ResetNeeded("step() before reset()")
        (*start, actions, _), self._episode = self._episode, None
        result = self._advance(action)
        actions += action.tobytes()
        self._episode = *start, actions, result[0].tobytes()
        return result

    def _weigh(self, terms: dict[str, float]) -> float:
        """Multiply a reward's terms by their weights; their sum, in their order."""
        total = 0.0
        for name in terms:
            terms[name] *= self.reward_weights.get(name, 1.0)
            total += terms[name]
        return total

    def get_state(self) -> EpisodeState:
        """The episode as it is, for `set_state` here or in another environment of this kind.

        Its start and its actions so far: neither Box2D nor PyBullet can save a world to the bit.
        It can be pickled. A `TimeLimit` around the environment counts its own steps.

        Raises:
            gymnasium.error.ResetNeeded: there is no episode.
        """
        if self._episode is None:
            raise ResetNeeded("get_state() before reset()")
        start, scales, actions, observation = self._episode
        random = copy.deepcopy((start, self.np_random))
        designs = np.array([scales, self.design])
        return EpisodeState(
            self._kind, random, self.np_random_seed, designs, bytes(actions), observation
        )

    def set_state(self, state: EpisodeState) -> None:
        """Go on from a saved episode: what follows has the bits of what followed `get_state`.

        The episode is played again from its start, which takes as long as it took. Copies, by
        `copy` or by pickle, do the same.

        Raises:
            InputError: of another kind of environment, or one that comes to something else here:
                other versions of the libraries. A reset must follow then.
        """
        if not isinstance(state, EpisodeState) or state.kind != self._kind:
            raise InputError(f"this is no state of a {self._kind}; take one from its get_state()")
        (start, now), (scales, design) = copy.deepcopy(state.random), state.designs
        shown, self.render_mode = self.render_mode, None
        try:
            self._take_design(scales)
            self._np_random, self._np_random_seed = start, state.seed
            self._begin()
            for action in np.frombuffer(state.actions).reshape(-1, *self.action_space.shape):
                HasDesign.step(self, action)
            same = self._episode[-1] == state.observation
        except BaseException:
            self._episode = None
            raise
        finally:
            self.render_mode = shown
        if not same:
            self._episode = None
            raise InputError(
                "the saved episode goes another way here: it was saved with other versions of "
                "designrl or its libraries"
            )
        self._take_design(design)
        self._np_random = now

    def _begin(self) -> np.ndarray:
        start, scales = copy.deepcopy(self.np_random), self.design
        self._episode = start, scales, bytearray(), b""  # Gymnasium's reset may take a step
        try:
            observation = self._start_episode()
        except BaseException:
            self._episode = None
            raise
        self._episode = start, scales, bytearray(), observation.tobytes()
        return observation

    @property
    def _kind(self) -> str:
        return f"{type(self).__name__}{self._ezpickle_args[1:-1]}"

    def __getstate__(self) -> dict:
        episode = None if self._episode is None else self.get_state()
        return {**super().__getstate__(), "episode": episode, "given": self.given_design}

    def __setstate__(self, state: dict) -> None:
        super().__setstate__(state)
        self.given_design = state["given"]
        if state["episode"] is not None:
            self.set_state(state["episode"])

    @property
    def design(self) -> np.ndarray:
        """(D,) scales, read-only; the body has those that are set from the next reset on.

        Raises:
            InputError: when set to what is not one of the body's designs.
        """
        return self._design

    @design.setter
    def design(self, scales) -> None:
        self._take_design(scales)
        self.given_design = self._design

    def _set_design(self, design, bounds) -> None:
        self._space = self.body.design.within(bounds)
        self._take_design(np.ones(self._space.size) if design is None else design)
        self.given_design = None if design is None else self._design

    def _take_design(self, scales) -> None:
        self._design = self._space.validate(scales)
        self._design.setflags(write=False)
        self._ezpickle_args = self._design, *self._ezpickle_args[1:]  # what a copy is made with


def checked_action(action, size: int) -> np.ndarray:
    """(size,) float64.

    Raises:
        InputError: anything else than that many finite numbers.
    """
    try:
        found = real_numbers(action)
    except ValueError:
        found = np.empty(0)
    if found.shape != (size,) or not np.isfinite(found).all():
        raise InputError(f"an action must be {size} finite numbers, got {action}")
    return found
