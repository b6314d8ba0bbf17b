"""Two stages of a measurement of Pd, over every outcome of both, weighted with its probability: no coin is tossed."""

import doctest

import numpy as np
import pytest
from scipy.stats import binom

from radalt.evaluation.engine import precision
from radalt.evaluation.engine.precision import PrecisionError, batches_needed, check_precision, most_batches
from radalt.evaluation.results.proportion import wilson_interval


def test_examples_in_docstrings_run():
    result = doctest.testmod(precision)
    assert result.attempted and not result.failed


def two_stages(p: float, pilot: int, wanted: float) -> dict[str, float]:
    """Coverage of the final interval, mean of the final Pd, mean trials and chance of a width above the one wanted."""
    out = dict.fromkeys(("coverage", "pd", "trials", "wide"), 0.0)
    for first, chance in enumerate(binom.pmf(np.arange(pilot + 1), pilot, p)):
        if chance < 1e-9:
            continue
        trials = pilot * batches_needed([{"correct": first, "trials": pilot}], wanted)
        more = np.arange(trials - pilot + 1)
        chances = binom.pmf(more, trials - pilot, p)
        more, chances = more[chances > 1e-9], chance * chances[chances > 1e-9]
        low, high = np.array([wilson_interval(first + int(k), trials) for k in more]).T
        out["coverage"] += chances @ ((low <= p) & (p <= high))
        out["pd"] += chances @ (first + more) / trials
        out["trials"] += chances.sum() * trials
        out["wide"] += chances @ ((high - low) / 2 > wanted)
    return out


@pytest.mark.parametrize(("pilot", "wanted"), [(150, 0.02), (150, 0.05), (30, 0.05)])
def test_the_interval_covers_as_that_of_a_fixed_count_does(pilot, wanted):
    for p in (0.5, 0.8, 0.9, 0.95, 0.97, 0.99, 0.995):
        found = two_stages(p, pilot, wanted)
        # Wilson's own coverage goes from 0.93 to 0.98 at these Pd and counts
        assert found["coverage"] > 0.93
        assert -1e-6 < found["pd"] - p < wanted / 7
        assert found["wide"] < 0.011
        assert found["trials"] <= pilot * most_batches(pilot, wanted)


def test_the_count_at_one_half_is_that_of_the_textbook():
    # Wilson: n = z^2 (1 / (4 w^2) - 1), four below the 2401 of the normal interval
    assert most_batches(1, 0.02) == pytest.approx(1.96**2 * (1 / (4 * 0.02**2) - 1), abs=2)
    assert most_batches(150, 0.02) == 16


def test_what_would_take_too_many_batches_is_refused_with_what_can_be_had():
    check_precision([150, 6, 0], 0.004 * 1.01)
    with pytest.raises(PrecisionError, match=r"^--precision 0\.001 may take 160\d\d\d batches of 6 trials; "):
        check_precision([150, 6, 0], 0.001)
