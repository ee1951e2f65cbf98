"""How healthy sets vary in time is found in a baseline, and what averages of them do follows from it."""

import numpy as np
import pytest

from analysis.diagnosis.noise import (
    BEFOREHAND,
    END_RATES,
    PHI,
    average_until_end,
    compute_noise_covariance,
    fit_noise_variances,
)
from analysis.diagnosis.state import MOST_AVERAGED, averaging_weights

BASELINE, DIRECTIONS = 200, 7


def sets(variances, n, seed=1):
    """Return a sum of autoregressions with coefficients `PHI` and these variances, shape (n, DIRECTIONS)."""
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    whole = sum(v * phi**apart for v, phi in zip(variances, PHI, strict=True))
    random = np.random.default_rng(seed)
    return np.linalg.cholesky(whole) @ random.standard_normal((n, DIRECTIONS))


def test_autocorrelation_and_slow_drift_are_estimated_where_present():
    independent, wandering = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.4, 0.0, 0.2, 0.0, 0.4, 0.0, 0.0]
    found = [
        fit_noise_variances(sets(true, BASELINE), np.arange(BASELINE)) for true in (independent, wandering)
    ]
    assert found[0][0] == pytest.approx(1.0, abs=0.15)  # seven times 200 sets tell a variance to .04
    for lag in (1, 20):
        # A part's variance goes to its neighbours in memory, which changes little of what it does.
        true = np.array(wandering) @ PHI**lag
        assert found[1] @ PHI**lag == pytest.approx(true, abs=0.12)
        assert found[0] @ PHI**lag < 0.5 * true


def test_a_gap_keeps_its_place_and_few_sets_keep_the_assumed_values():
    x, kept = sets([0.1, 0.0, 0.9, 0.0, 0.0, 0.0, 0.0], BASELINE), np.arange(0, BASELINE, 5)
    found = [fit_noise_variances(x[kept], indices) for indices in (kept, np.arange(kept.size))]
    # Five sets apart they are nearly independent, which next to each other no memory of five explains.
    assert found[0][2] > 2.0 * found[1][2]
    few = fit_noise_variances(sets([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 15), np.arange(15))
    assert few[4:] == pytest.approx(BEFOREHAND[4:], rel=0.5)


@pytest.mark.parametrize(("n", "since", "confirmation_ago"), [(12, 12, None), (40, 43, None), (30, 30, 4)])
def test_differences_from_a_baseline_scatter_as_its_parts_make_them(n, since, confirmation_ago):
    reference = 50
    ago = np.arange(reference)[::-1]
    ends = np.array([rate * (1.0 - rate) ** ago for rate in END_RATES])
    after = averaging_weights(n)[:, ::-1]
    rows = np.zeros((5, reference + since))
    rows[:2, :reference], rows[2:, reference + since - n :] = ends, after
    rows[:, :reference] -= rows.sum(axis=1)[:, None] / reference
    apart = np.abs(np.subtract.outer(np.arange(reference + since), np.arange(reference + since)))
    for phi, found in zip(PHI, compute_noise_covariance(n, since, confirmation_ago, reference), strict=True):
        assert found[:5, :5] == pytest.approx(rows @ phi**apart @ rows.T, abs=1e-12)
        assert np.linalg.eigvalsh(found).min() > -1e-12  # rounding of a slow part, which cancels nearly
        if confirmation_ago is not None:
            mean = np.zeros(reference + since)
            mean[:reference] = 1.0 / reference
            to_planned = phi ** np.maximum(
                np.abs(np.arange(reference + since) - (reference + since - 1 - confirmation_ago)), 1
            )
            assert found[5, 5] == pytest.approx(1.0 - 2.0 * mean @ to_planned + mean @ phi**apart @ mean)


def test_the_end_of_a_baseline_is_estimated_from_its_last_sets():
    changes = np.zeros((BASELINE, DIRECTIONS))
    changes[-1] = 1.0
    assert average_until_end(changes) == pytest.approx(np.outer(END_RATES, np.ones(DIRECTIONS)))
    assert average_until_end(changes[:-1]) == pytest.approx(0.0)
    # What a wander owes to the baseline is forgotten in the end, and nothing else.
    near, far = (
        compute_noise_covariance(MOST_AVERAGED, since, None, BASELINE)[5, 2:, 2:] for since in (250, 2000)
    )
    assert (np.diag(far) > np.diag(near)).all()
