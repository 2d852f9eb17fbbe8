"""What all environments hold to: Gymnasium's rules, and episodes that repeat to the bit."""

import copy
import dataclasses
import pickle
import signal
import warnings
from functools import reduce
from operator import add

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import designrl  # noqa: F401
from designrl.envs.tasks import WORLDS
from designrl.errors import InputError

STEPS = {
    "designrl/BipedalWalker-v0": 1600,
    "designrl/BipedalWalkerHardcore-v0": 2000,
    "designrl/Ant-v0": 1000,
}
pytestmark = pytest.mark.parametrize("env_id", STEPS)


def make(env_id, **kwargs):
    return gymnasium.make(env_id, disable_env_checker=True, **kwargs)


def designs(env_id) -> np.ndarray:
    """(2, D) two bodies."""
    size = make(env_id).unwrapped.body.design.size
    return np.random.default_rng(7).uniform(0.25, 1.75, (2, size))


def trajectory(env, seed, steps=150, **options):
    """Observations and rewards under actions that depend on the seed alone."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed, options=options)
    rows = [np.append(observation, 0.0)]
    for _ in range(steps):
        action = rng.uniform(-1, 1, env.action_space.shape)
        observation, reward, terminated, truncated, _ = env.step(action)
        rows.append(np.append(observation.astype(np.float64), reward))
        if terminated or truncated:
            break
    return np.array(rows)


def test_gymnasiums_checker_accepts_it(env_id):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it also wishes for bounded observations
        env = make(env_id, design=designs(env_id)[0], render_mode="rgb_array")
        check_env(env.unwrapped, skip_render_check=False)


def test_an_episode_does_not_depend_on_earlier_ones(env_id):
    body, other = designs(env_id)
    first = trajectory(make(env_id, design=body), 3)
    env = make(env_id, design=other)
    trajectory(env, 5)
    np.testing.assert_array_equal(trajectory(env, 3, design=body), first)
    for seed in range(4):
        trajectory(env, seed, steps=50)
    np.testing.assert_array_equal(trajectory(env, 3), first)  # the body was kept
    env.close()
    np.testing.assert_array_equal(trajectory(env, 3), first)
    trajectory(env, 5, design=other)
    np.testing.assert_array_equal(trajectory(env, 3, design=body), first)  # and made again


def test_looking_at_it_changes_nothing(env_id):
    class Looked(gymnasium.Wrapper):
        steps = 0

        def step(self, action):
            self.steps += 1
            if self.steps % 15 == 0:
                self.render()
            env, body = self.unwrapped, self.unwrapped.body
            poses = body.poses(env)
            for look in (body.joint_states, body.contacts, body.lidar, body.terrain):
                look(env)
            body.ground_near(env, poses[0][0])
            return super().step(action)

    body, _ = designs(env_id)
    looked = Looked(make(env_id, design=body, render_mode="rgb_array"))
    np.testing.assert_array_equal(trajectory(looked, 1), trajectory(make(env_id, design=body), 1))


def test_an_episode_is_truncated_at_the_time_limit(env_id):
    rows = trajectory(make(env_id), seed=2, steps=STEPS[env_id] + 100)  # one that never falls
    assert len(rows) == 1 + STEPS[env_id]
    assert rows[-1, -1] > -100


def test_many_live_in_one_process(env_id):
    body, _ = designs(env_id)
    alone = trajectory(make(env_id, design=body), 1)
    envs = [make(env_id, design=body) for _ in range(20)]
    for env in envs:
        env.reset(seed=5)
    np.testing.assert_array_equal(trajectory(envs[7], 1), alone)


def test_weighted_terms_add_up_to_the_reward_and_a_copy_has_them(env_id):
    first, second, *_ = terms = WORLDS[env_id].reward_terms
    weights = {second: 0.0, first: -2.5}
    plain, weighted = make(env_id), make(env_id, reward_weights=weights)
    copy = pickled(weighted)
    rng = np.random.default_rng(0)
    for env in (plain, weighted, copy):
        env.reset(seed=0)
    for _ in range(60):
        action = rng.uniform(-1, 1, plain.action_space.shape)
        (*_, info), (_, reward, *_, more) = (env.step(action) for env in (plain, weighted))
        assert tuple(more["reward_terms"]) == terms
        for name, value in info["reward_terms"].items():
            assert more["reward_terms"][name] == value * weights.get(name, 1.0)
        assert reward == reduce(add, more["reward_terms"].values(), 0.0)
        assert copy.step(action)[1] == reward


def test_weights_of_one_change_no_bit_of_the_reward(env_id):
    ones = dict.fromkeys(WORLDS[env_id].reward_terms, 1)
    plain, weighted = make(env_id), make(env_id, reward_weights=ones)
    assert trajectory(plain, 3).tobytes() == trajectory(weighted, 3).tobytes()


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ({"energi": 2.0}, "no reward term 'energi'; there are .*progress"),
        ({"progress": np.nan}, "the weight of progress is nan; it must be a number from -1e.06"),
        ({"progress": 2e6}, "the weight of progress is 2000000.0"),
        ({"progress": "2"}, "the weight of progress is '2'"),
        ({"progress": 10**400}, "the weight of progress is 1000"),
        ([2.0], "it must name terms and their weights"),
    ],
)
def test_weights_that_do_not_fit_are_refused(env_id, weights, words):
    with pytest.raises(InputError, match=words):
        make(env_id, reward_weights=weights)
    with pytest.raises(InputError, match=words):
        gymnasium.make_vec(env_id, 2, "vector_entry_point", reward_weights=weights)


def test_wrong_arguments_are_refused(env_id):
    env = make(env_id)
    space, size = env.unwrapped.body.design, env.action_space.shape[0]
    wrong = np.ones(space.size)
    for value in (1.8, np.nan):
        wrong[3] = value
        with pytest.raises(ValueError, match=rf"{space.names[3]}.*\[0.25, 1.75\]"):
            make(env_id, design=wrong)
        with pytest.raises(ValueError, match=space.names[3]):
            env.reset(options={"design": wrong})
        with pytest.raises(ValueError, match=space.names[3]):
            env.unwrapped.design = wrong
    with pytest.raises(ValueError, match="read-only"):
        env.unwrapped.design[0] = 9.0
    with pytest.raises(ValueError, match="reset options are a dict"):
        env.unwrapped.reset(options=list(wrong))
    with pytest.raises(ValueError, match=f"{space.size} scales"):
        env.reset(options={"design": np.ones(space.size + 1)})
    with pytest.raises(ValueError, match="'desing'"):
        env.reset(options={"desing": np.ones(space.size)})
    env.reset(seed=0)
    nan = np.full(size, np.nan)
    masked = np.ma.masked_array(np.zeros(size), mask=True)
    strange = (["a"] * size, ["0"] * size, [1j] * size, [10**400] * size, [[0], [0, 1]], masked)
    for action in (np.zeros(size - 1), nan, np.zeros((size, 1)), 0.0, None, *strange):
        with pytest.raises(InputError, match=f"{size} finite numbers"):
            env.unwrapped.step(action)


def test_seeds_are_whole_numbers_of_any_type(env_id):
    env = make(env_id)
    expected = env.reset(seed=3)[0]
    for seed in (np.uint8(3), np.array(3)):
        np.testing.assert_array_equal(env.reset(seed=seed)[0], expected)
    before = env.unwrapped.np_random.bit_generator.state
    for seed in (-1, 3.0, "3", np.array([3]), np.ma.masked, [1]):
        with pytest.raises(InputError, match="seed is .* whole number from 0 on"):
            env.reset(seed=seed)
    assert env.unwrapped.np_random.bit_generator.state == before


def pickled(thing):
    return pickle.loads(pickle.dumps(thing))


def same_future(one, other, steps=60, seed=4) -> bool:
    """Under the same actions, and through the reset after them."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        action = rng.uniform(-1, 1, one.action_space.shape)
        (seen, *first), (seen_there, *second) = one.step(action), other.step(action)
        if seen.tobytes() != seen_there.tobytes() or first != second:
            return False
    return one.reset()[0].tobytes() == other.reset()[0].tobytes()


def test_what_follows_a_restore_has_the_bits_of_what_followed_the_save(env_id):
    body, later = designs(env_id)
    env = make(env_id, design=body).unwrapped
    trajectory(env, 2, steps=20)
    env.reset()  # its generator has been in use
    for action in np.random.default_rng(3).uniform(-1, 1, (70, *env.action_space.shape)):
        env.step(action)
    env.design = later  # from the next reset on
    state = pickled(env.get_state())
    other, third = make(env_id).unwrapped, make(env_id).unwrapped
    third.set_state(state)
    assert third.np_random_seed == 2
    for copied in (copy.copy(env), copy.deepcopy(env), pickled(env), third):
        other.set_state(state)
        np.testing.assert_array_equal(other.design, later)
        assert same_future(copied, other)
    assert same_future(env, third) is False
    third.set_state(state)
    env.set_state(state)
    assert same_future(env, third)


def test_a_copy_goes_on_within_its_wrappers(env_id):
    env = gymnasium.make(env_id, max_episode_steps=50)
    env.reset(seed=0)
    still = np.zeros(env.action_space.shape)
    for _ in range(40):
        env.step(still)
    other = copy.deepcopy(env)
    ends = [[each.step(still)[3] for _ in range(10)] for each in (env, other)]
    assert ends == [[False] * 9 + [True]] * 2
    assert same_future(env, other, steps=5)


def test_a_state_that_does_not_fit_is_refused(env_id):
    env = make(env_id).unwrapped
    for call in (env.get_state, lambda: env.step(np.zeros(env.action_space.shape))):
        with pytest.raises(ResetNeeded, match=r"\(\) before reset\(\)"):
            call()
    env.reset(seed=0)
    state, action = env.get_state(), np.zeros(env.action_space.shape)
    elsewhere = dataclasses.replace(state, observation=b"of other libraries")
    for wrong in (None, dataclasses.replace(state, kind="Hopper()")):
        with pytest.raises(InputError, match="no state of a "):
            env.set_state(wrong)
    env.step(action)
    with pytest.raises(InputError, match="goes another way here"):
        env.set_state(elsewhere)
    with pytest.raises(ResetNeeded):
        env.step(action)
    env.set_state(state)
    env.step(action)


def test_a_step_that_was_interrupted_asks_for_a_reset(env_id, monkeypatch):
    env = make(env_id).unwrapped
    env.reset(seed=0)
    state, action = env.get_state(), np.zeros(env.action_space.shape)
    with monkeypatch.context() as patch:
        patch.setattr(type(env), "_advance", lambda *_: signal.raise_signal(signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            env.step(action)
    with pytest.raises(ResetNeeded):
        env.step(action)
    env.set_state(state)
    env.step(action)


@pytest.mark.parametrize("set_by", ["reset", "attribute"])
def test_a_copy_has_the_design_that_was_set(env_id, set_by):
    env = gymnasium.make(env_id).unwrapped
    design = np.full(env.body.design.size, 1.25)
    if set_by == "reset":
        env.reset(seed=0, options={"design": design})
    else:
        env.design = design
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        np.testing.assert_array_equal(copied.reset(seed=1)[0], env.reset(seed=1)[0])
        np.testing.assert_array_equal(copied.design, design)


def test_bounds_of_the_design_are_the_environments_own(env_id):
    size = make(env_id).unwrapped.body.design.size
    large = np.linspace(0.3, 3.9, size)
    env = make(env_id, design=large, design_bounds=(0.25, 4.0))
    np.testing.assert_array_equal(env.unwrapped.design, large)
    for copied in (copy.deepcopy(env), pickled(env)):
        np.testing.assert_array_equal(copied.unwrapped.design, large)
        np.testing.assert_array_equal(trajectory(copied, 2), trajectory(env, 2))
        copied.reset(seed=0, options={"design": np.full(size, 4.0)})
    for refusing in (env, gymnasium.make_vec(env_id, 2, design_bounds=(0.25, 4.0))):
        with pytest.raises(InputError, match=r"is 4.1; each must be in \[0.25, 4.0\]"):
            refusing.reset(options={"design": np.full(size, 4.1)})
    with pytest.raises(InputError, match="the highest, from 1 to 100"):
        make(env_id, design_bounds=(0.25, 0.5))
    with pytest.raises(InputError, match='bodies of 0.05 to 5 times.*"sync" runs single'):
        gymnasium.make_vec(env_id, 2, design_bounds=(0.25, 5.1))
