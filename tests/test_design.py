import json
from dataclasses import replace

import numpy as np
import pytest

from designrl.bodies.ant import ANT
from designrl.bodies.walker import WALKER, leg_area
from designrl.envs.tasks import leg_area_reward_factor
from designrl.errors import InputError
from designrl.experiments import get_experiment
from reproduce.paths import paper


def test_zero_parameters_are_the_original_body():
    np.testing.assert_array_equal(
        WALKER.design.dimensions(WALKER.design.scales(np.zeros(8))), WALKER.design.originals
    )


def test_original_walker_is_table_2s_first_row():
    assert WALKER.design.originals.tolist() == paper()["table2"]["biped"]["dimensions"]
    assert WALKER.design.names[:4] == (
        "top leg 1 width",
        "top leg 1 height",
        "bottom leg 1 width",
        "bottom leg 1 height",
    )


def test_ant_has_3_parts_of_3_numbers_on_4_legs():
    assert ANT.design.size == 36
    legs = ANT.design.originals.reshape(4, 9)
    for leg, (x, y) in zip(legs, ((1, 1), (-1, 1), (-1, -1), (1, -1)), strict=True):
        np.testing.assert_array_equal(leg[:6], [0.2 * x, 0.2 * y] * 2 + [0.4 * x, 0.4 * y])
        assert (leg[6:] == 0.08).all()
    assert ANT.design.names[9] == "front right top dx"


@pytest.mark.parametrize("name", ["biped-morphology", "biped-hardcore-morphology-smaller-leg"])
def test_leg_area_of_the_papers_designs_is_the_papers(name):
    row = paper()["table2"][name]
    scales = np.array(row["dimensions"]) / WALKER.design.originals
    percent = 100 * leg_area(scales) / leg_area(np.ones(8))
    assert percent == pytest.approx(row["leg_area"], abs=1.0)


def test_reward_factor_is_one_for_the_original_and_grows_as_legs_shrink():
    assert leg_area_reward_factor(np.ones(8)) == 1.0
    assert leg_area_reward_factor(np.full(8, 0.5)) == pytest.approx(1 + np.log(4))


@pytest.mark.parametrize(
    ("scales", "words"),
    [
        ([1.0] * 7, "8 scales"),
        ([1.0] * 7 + [float("nan")], "bottom leg 2 height"),
        ([1.0, 1.76] + [1.0] * 6, r"top leg 1 height\) is 1.76; each must be in \[0.25, 1.75\]"),
        ([0.2] + [1.0] * 7, "top leg 1 width"),
        (["a"] * 8, "8 numbers"),
        (None, "8 scales"),
        ([[1.0] * 8], "8 scales"),
    ],
)
def test_a_wrong_design_is_refused_by_name(scales, words):
    with pytest.raises(InputError, match=words):
        WALKER.design.validate(scales)


LIMITS = {
    "limit": ({"limit": 0.5}, 0.5, 1.5),
    "bounds": ({"bounds": (0.5, [1.0, 2.0, 3.0, 4.0] * 2)}, 0.5, [1.0, 2.0, 3.0, 4.0] * 2),
    "lognormal": ({"form": "lognormal"}, 0.25, 4.0),
    "narrow lognormal": ({"form": "lognormal", "limit": 2.0}, 0.5, 2.0),
}


@pytest.mark.parametrize(("limits", "low", "high"), LIMITS.values(), ids=LIMITS)
def test_limits_are_data(limits, low, high):
    space = replace(WALKER.design, **limits)
    ends = [space.scales(np.full(8, p)).tolist() for p in (-1e300, 0.0, 1e300)]
    assert ends == [np.broadcast_to(x, 8).tolist() for x in (low, 1.0, high)]
    p = np.random.default_rng(0).normal(0.0, 2.0, (100, 8))
    scales = space.scales(p)
    if "form" in limits:
        np.testing.assert_allclose(scales, np.clip(np.exp(p), low, high))
    else:
        reach = np.where(p < 0, 1 - np.array(low), np.array(high) - 1)
        np.testing.assert_allclose(scales, 1 + reach * np.tanh(p))
    for row in scales:
        space.validate(row)
        np.testing.assert_array_equal(space.scales(p[0]), scales[0])  # alone as among others
    kept = json.loads(json.dumps(space.limits))
    again = get_experiment("biped-morphology").space(kept)
    np.testing.assert_array_equal(again.scales(p), scales)


def test_the_papers_limits_keep_their_bits():
    p = np.random.default_rng(0).normal(0.0, 2.0, (100, 36))
    np.testing.assert_array_equal(ANT.design.scales(p), 1.0 + 0.75 * np.tanh(p))


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"form": "normal"}, "one of bounded, lognormal"),
        *(({"limit": limit}, "above 0 and at most 0.99") for limit in (0, 1.0, -1, np.nan)),
        ({"limit": "half"}, "design limit is 'half'; it must be a number"),
        *(({"form": "lognormal", "limit": x}, "above 1 and at most 100") for x in (0, 1, 101)),
        *(
            ({"bounds": bounds}, "lowest scale, from 0.01 to 1")
            for bounds in (0.5, (0.5,), (1.1, 2), (0.1, 0.9), (0, 2), ("a", 2), ([0.5] * 7, 2))
        ),
    ],
)
def test_wrong_limits_are_refused(limits, words):
    with pytest.raises(InputError, match=words):
        replace(WALKER.design, **limits)


def test_a_scale_beyond_its_own_bounds_is_refused():
    space = WALKER.design.within(([0.5] * 7 + [0.9], 2.0))
    with pytest.raises(InputError, match=r"bottom leg 2 height\) is 0.8; it must be in \[0.9, 2.0"):
        space.validate([0.8] * 8)
