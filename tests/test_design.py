import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from designrl.bodies.ant import ANT
from designrl.bodies.walker import WALKER, leg_area
from designrl.envs.tasks import leg_area_reward_factor
from designrl.errors import InputError
from reproduce.paths import paper


@given(st.lists(st.floats(-1e6, 1e6), min_size=8, max_size=8))
def test_any_parameters_give_a_valid_design(parameters):
    WALKER.design.validate(WALKER.design.scales(parameters))


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
