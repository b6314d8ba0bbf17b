"""Break-point and gain: one definition, on curves whose answer is known."""

import doctest
import math

import pytest

from radalt.evaluation.results import break_point as module
from radalt.evaluation.results import proportion as intervals
from radalt.evaluation.results.break_point import break_point, protection_gain


@pytest.mark.parametrize("tested", [module, intervals])
def test_examples_in_docstrings_run(tested):
    result = doctest.testmod(tested)
    assert result.attempted and not result.failed


def test_it_is_where_the_line_between_two_sirs_falls_through_the_level_in_any_order_of_the_rows():
    """The curve on which four definitions gave -20, -20 and -21.1."""
    found = break_point([-10, -20, -30, -40], [1, 0.95, 0.5, 0.1])
    assert found.sir_db == pytest.approx(-20 - 10 * 0.05 / 0.45) and found.mark == ""
    assert break_point([-30, -10, -40, -20], [0.5, 1, 0.1, 0.95]) == found


def test_a_dip_is_where_it_breaks_however_well_it_holds_below():
    assert break_point([-10, -20, -30], [1, 0.4, 1]).sir_db == pytest.approx(-10 - 10 / 6)


def test_the_grids_ends_stay_open():
    curves = [0.95, 0.92], [0.5, 0.2], [math.nan, 0.2]  # nothing measured is no success
    assert [break_point([-10, -20], pd).mark for pd in curves] == ["<=", ">=", ">="]


def test_bounds_of_pd_give_an_interval_of_the_break_point():
    found = break_point([-10, -20, -30], [1, 0.9, 0.2], low=[0.95, 0.8, 0.1], high=[1, 0.97, 0.4])
    assert found.low_db < found.sir_db < found.high_db


@pytest.mark.parametrize(
    ("base", "method", "mark"),
    [("", "", ""), ("", "<=", ">="), (">=", "", ">="), ("<=", "", "<="), ("", ">=", "<="), (">=", "<=", ">="),
     ("<=", "<=", "?"), (">=", ">=", "?")],
)  # fmt: skip
def test_open_ends_propagate_into_the_gain(base, method, mark):
    curves = {"": [1, 0], "<=": [1, 1], ">=": [0, 0]}
    gain = protection_gain(break_point([-20, -30], curves[base]), break_point([-20, -30], curves[method]))
    assert gain.mark == mark and math.isnan(gain.db) == (mark == "?")
