"""Loss of wall from ln features: intervals over true losses, state, refusals. The bank is invented."""

import bz2
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from analysis.errors import InvalidInputError
from analysis.wall import posterior
from analysis.wall.bank import FEATURES, Bank
from analysis.wall.calibration import SLOW_DRIFT, calibrate
from analysis.wall.posterior import (
    LOSSES,
    RATES_PER_H,
    WallState,
    add_set,
    begin,
    compare,
    predict_changes,
    wait,
)

SOUND = np.log([336e-6, 0.47, 0.6, 70e-6, 2.7])
SD = np.array([0.005, 0.03, 0.02, 0.008, 0.05])
HOURS = 24.0 + 17.0 * np.arange(1, 21)


def curve(size):
    grid = np.linspace(0.0, 0.8, 33)
    wall = np.stack([size * grid**2, -size * grid, -0.6 * size * grid, 0.0 * grid, 0.0 * grid], axis=1)
    return grid, wall


@pytest.fixture(scope="module")
def bank():
    sizes = (0.3, 0.6, 0.9)
    return Bank(
        losses=curve(1.0)[0],
        changes=np.array([curve(size)[1] for size in sizes]),
        models=("solid",) * 3,
        kinds=("size",) * 3,
        sizes_m=np.array(sizes) * 0.05,
        names=("small", "medium", "large"),
        sound=SOUND,
        slopes=np.diag(SD / 0.02),
        sources=tuple(f"stiffness_{k}" for k in range(5)),
        thickness_m=6.35e-3,
        digest="invented",
    )


@pytest.fixture(scope="module")
def changes(bank):
    return predict_changes(bank)


def draw_sets(seed, losses, size=0.6, n=48):
    """Return a baseline and sets with these losses of the wall, both of ln features."""
    random = np.random.default_rng(seed)
    baseline, later = (
        SOUND + SD * random.standard_normal((n, 5)),
        SD * random.standard_normal((len(losses), 5)),
    )
    grid, wall = curve(size)
    of_wall = np.stack([np.interp(losses, grid, column) for column in wall.T], axis=1)
    return baseline, SOUND + later + of_wall


def run(bank, changes, seed, losses, **how):
    baseline, sets = draw_sets(seed, losses, **how)
    calibration = calibrate(bank, baseline)
    hypotheses, state = compare(calibration, changes), begin(len(changes), 24.0)
    states = []
    for hour, logs in zip(HOURS, sets, strict=False):
        assert hypotheses.compute_misfit(logs, state.slow) < 1.0
        state = add_set(state, hypotheses, logs, hour)
        states.append(state)
    return states


def test_the_interval_covers_a_growing_loss_and_a_sound_wall_is_bounded(bank, changes):
    losses = 0.5 * np.arange(1, 21) / 20.0
    found = [posterior.estimate_loss(run(bank, changes, seed, losses)[-1]) for seed in range(10)]
    assert sum(one.low <= 0.5 <= one.high for one in found) >= 8
    assert all(abs(one.median - 0.5) < 0.15 for one in found)
    sound = [posterior.estimate_loss(run(bank, changes, seed, np.zeros(20))[-1]) for seed in range(10)]
    assert sum(one.low == 0.0 for one in sound) >= 9
    assert np.median([one.high for one in sound]) < 0.1  # twice the loss that changes the ratio by its SD


def test_the_median_follows_the_sets_and_never_falls_far_when_they_return(bank, changes):
    there_and_back = np.concatenate([np.linspace(0.04, 0.4, 10), np.linspace(0.36, 0.0, 10)])
    medians = [posterior.estimate_loss(state).median for state in run(bank, changes, 3, there_and_back)]
    assert medians[9] > 0.3
    assert medians[-1] > 0.15, "a wall does not grow again"


def test_a_packed_state_is_read_with_its_digits_and_near_the_one_packed(bank, changes):
    state = run(bank, changes, 4, np.linspace(0.0, 0.3, 20))[-1]
    packed = posterior.pack_state(state)
    read = posterior.unpack_state(packed)
    assert len(packed) < 200_000
    assert read.hour == state.hour
    assert posterior.pack_state(read) == packed
    assert np.array_equal(posterior.unpack_state(posterior.pack_state(read)).joint, read.joint)
    assert read.joint.sum() == pytest.approx(1.0, abs=1e-5)
    assert read.window == state.window
    assert np.array_equal(read.joint > 0.0, state.joint > 0.0)
    assert np.allclose(read.joint, state.joint, rtol=0.2)  # steps of 20 %


def test_a_stored_state_has_no_probability_where_there_was_none():
    state = state_of([(0.1, 1e-3, 0.999), (0.2, 1e-3, 1e-3), (0.3, 1e-3, 1e-6)])
    kept = posterior.unpack_state(posterior.pack_state(state))
    assert np.count_nonzero(kept.joint) == 2, "but for the one below the least"
    assert kept.window == slice(20, 41)
    assert kept.joint[-1].max() == pytest.approx(1e-3, rel=0.2)  # steps of 20 %


def test_losses_with_others_between_them_that_have_no_probability_are_packed_exactly():
    cells = [(loss, rate, 0.25 + loss) for loss in (0.0, 0.1, 0.105, 0.4, 0.8) for rate in (0.0, 1e-4, 1e-2)]
    rounded = posterior.round_state(state_of(cells))
    read = posterior.unpack_state(posterior.pack_state(rounded))
    assert np.count_nonzero(read.joint) == len(cells)
    np.testing.assert_array_equal(read.joint, rounded.joint)


def test_a_state_is_summed_once_for_all_that_is_stated_about_it():
    state = state_of([(0.1, 1e-3, 0.6), (0.2, 1e-3, 0.4)])
    before = posterior._sum_by_cell.cache_info().misses
    posterior.pack_state(state)
    posterior.estimate_loss(state)
    posterior.estimate_rate(state)
    posterior.compute_exceedance(state, 0.15)
    posterior.forecast(state, 0.5)
    posterior.predict_loss(state, 10.0)
    assert posterior._sum_by_cell.cache_info().misses == before + 1
    other = state_of([(0.3, 1e-3, 1.0)])
    assert posterior.estimate_loss(other).median > 0.25, "another state has its own"


def test_a_stored_state_keeps_the_most_probable_cells(monkeypatch):
    monkeypatch.setattr(posterior, "MOST_CELLS", 100)
    joint = np.zeros((len(LOSSES), len(RATES_PER_H), 2), dtype=np.float32)
    joint.flat[:400] = np.geomspace(1.0, 2e-4, 400)
    state = posterior.round_state(WallState(joint=joint / joint.sum(), hour=1.0))
    possible = np.flatnonzero(state.joint)
    assert 85 < len(possible) <= 100, "whole steps of 20 %, some 9 cells each"
    assert np.array_equal(possible, np.arange(len(possible)))
    assert np.array_equal(posterior.unpack_state(posterior.pack_state(state)).joint, state.joint)


@pytest.mark.parametrize("packed", [b"", b"other", bz2.compress(b"12345678" + b"\1" * 77)])
def test_other_bytes_are_no_state(packed):
    with pytest.raises(InvalidInputError, match="are no state of a wall"):
        posterior.unpack_state(packed)


def test_a_set_of_another_sensor_is_not_explained_and_a_sound_one_bounds_the_loss(bank, changes):
    baseline, sets = draw_sets(5, np.zeros(1))
    hypotheses, before = compare(calibrate(bank, baseline), changes), begin(len(changes), 24.0)
    other_sensor = sets[0] + np.array([0.0, 0.0, 0.0, 0.2, -1.0])
    assert hypotheses.compute_misfit(other_sensor, before.slow) > 1.0
    assert hypotheses.compute_misfit(sets[0], before.slow) < 1.0
    seen = add_set(before, hypotheses, sets[0], 41.0)
    assert posterior.estimate_loss(seen).high < posterior.estimate_loss(wait(before, 41.0)).high


def test_distances_are_those_of_whitened_differences_and_infinite_past_a_curve(bank, changes):
    baseline, sets = draw_sets(5, np.zeros(1))
    calibration = calibrate(bank, baseline)
    cut = changes.copy()
    cut[0, 100:] = np.nan
    distances = compare(calibration, cut).compute_distances(sets[0]).T
    white = (sets[0] - calibration.mean - changes[1, 40]) @ calibration.whitening
    assert distances[1, 40] == pytest.approx(white @ white, rel=1e-5)  # of 32 bits
    assert np.isinf(distances[0, 100:]).all()
    assert np.isfinite(distances[0, :100]).all()


def test_the_slow_drift_is_that_of_a_kalman_filter_on_a_sound_wall(bank, changes):
    baseline, sets = draw_sets(10, np.zeros(4))
    calibration, hours = calibrate(bank, baseline), np.array([30.0, 31.0, 50.0, 200.0])
    hypotheses, state = compare(calibration, changes), begin(len(changes), 24.0)
    for hour, logs in zip(hours, sets, strict=True):
        state = add_set(state, hypotheses, logs, hour)
    # The same by the covariance of all sets: drift of days, of months since the state's begin, white noise.
    white = (sets - calibration.mean) @ calibration.whitening
    apart, both = np.abs(hours[:, None] - hours), hours[:, None] + hours - 2.0 * 24.0
    days, months, _ = posterior.MEMORY_H
    parts = calibration.slow * np.exp(-apart / days), np.exp(-apart / months) - np.exp(-both / months)
    parts = parts[0], posterior.MONTHS * parts[1]
    of_sets = parts[0] + parts[1] + (1.0 - calibration.slow) * np.eye(4)
    for k, part in enumerate(parts):
        weights = np.linalg.solve(of_sets, part[-1])
        assert np.allclose(state.slow.estimate[k, :5], weights @ white)
        assert np.allclose(state.slow.estimate[k, 5:], [weights.sum(), weights @ hours])
        left = part[-1, -1] - weights @ part[-1]
        assert state.slow.compute_variance(calibration.slow)[k, k] == pytest.approx(left)
    later = wait(state, 200.0 + days).slow
    assert np.allclose(later.estimate[0], np.exp(-1.0) * state.slow.estimate[0])
    variance = later.compute_variance(calibration.slow)
    assert variance[0, 0] == pytest.approx(calibration.slow - np.exp(-2.0) * state.slow.explained[0, 0])
    grown = state.slow.compute_variance(calibration.slow)[1, 1] * np.exp(-2.0 * days / months)
    assert variance[1, 1] == pytest.approx(grown + posterior.MONTHS * (1.0 - np.exp(-2.0 * days / months)))


def test_the_slow_drift_follows_from_the_loss_that_a_rate_had_before(bank, changes, monkeypatch):
    monkeypatch.setattr(posterior, "RESEAT_ODDS", 1e-300)
    calibration = calibrate(bank, draw_sets(11, [])[0])
    rate = RATES_PER_H[8]
    offset = np.array([0.4, -0.2, 0.1, 0.0, 0.3])
    estimate = np.outer([0.75, 0.25, 0.0], [*offset.tolist(), 0.6, 0.6 * 40.0])
    slow = posterior.SlowDrift(estimate=estimate, explained=np.diag([0.1, posterior.MONTHS, 0.0]))
    before = replace(state_of([(0.2, 0.0, 0.5), (0.2, rate, 0.5)]), slow=slow)
    logs = calibration.mean + np.array([0.03, -0.1, -0.07, 0.0, 0.01])
    after = add_set(before, compare(calibration, changes[:1]), logs, 100.0, exponent=1.0)
    evidence = []
    for then in (0.2, LOSSES[40 - round(rate * 60.0 / LOSSES[1])]):
        predicted = changes[0, 40] - 0.6 * changes[0, np.abs(LOSSES - then).argmin()]
        rest = (logs - calibration.mean - predicted) @ calibration.whitening - offset
        variance = 1.0 - 0.1
        distance = rest @ rest / (variance * calibration.dof)
        evidence.append(-0.5 * (calibration.dof + 5) * np.log1p(distance))
    found = after.joint[40 - after.first, 8, 0] / after.joint[40 - after.first, 0, 0]
    assert then < 0.18
    assert found == pytest.approx(np.exp(evidence[1] - evidence[0]), rel=1e-3)


def test_a_shift_of_the_incident_wave_is_a_reseat_and_a_growing_loss_is_none(bank, changes):
    states = run(bank, changes, 12, np.linspace(0.0, 0.5, 20))
    assert not any(state.slow.explained[2, 2] for state in states)
    hypotheses, before = compare(calibrate(bank, draw_sets(12, [])[0]), changes), states[-1]
    of_wall = curve(0.6)[1][20]
    shifted = SOUND + of_wall + np.array([0.01, 0.0, 0.0, 0.02, 0.3])
    after = add_set(before, hypotheses, shifted, before.hour + 17.0).slow
    white = (shifted - hypotheses.calibration.mean) @ hypotheses.calibration.whitening
    expected = before.slow.wait(17.0).reseat().add(white, before.hour + 17.0, hypotheses.calibration.slow)
    assert np.allclose(after.explained, expected.explained)
    assert np.allclose(after.estimate, expected.estimate)
    assert not add_set(before, hypotheses, SOUND + of_wall, before.hour + 17.0).slow.explained[2, 2]
    # A smaller one is found where the diagnosis names sensor or coupling.
    smaller = SOUND + of_wall + 0.7 * (shifted - SOUND - of_wall)
    found = [
        add_set(before, hypotheses, smaller, before.hour + 17.0, diagnosed=diagnosed).slow.explained[2, 2]
        for diagnosed in (False, True)
    ]
    assert found[1] < found[0] == 0.0
    # It stays: months later nothing of it is lost.
    assert np.array_equal(after.wait(5000.0).estimate[2], after.estimate[2])
    added = after.compute_variance(0.3)[2, 2] - before.slow.compute_variance(0.3)[2, 2]
    assert 0.0 < added < posterior.RESEAT, "the set has shown a part of the offset"


def test_a_set_at_an_offset_that_is_estimated_is_explained(bank, changes):
    hypotheses = compare(calibrate(bank, draw_sets(11, [])[0]), changes)
    white = np.array([0.0, 0.0, 0.0, 7.0, 0.0])
    logs = hypotheses.calibration.mean + white @ np.linalg.inv(hypotheses.calibration.whitening)
    slow = posterior.SlowDrift()
    assert hypotheses.compute_misfit(logs, slow) > 1.0
    for hour in range(20):
        slow = (slow if hour else slow.reseat()).add(white, float(hour), hypotheses.calibration.slow)
    assert hypotheses.compute_misfit(logs, slow) < 0.1
    assert hypotheses.compute_misfit(hypotheses.calibration.mean, slow) < 0.1
    thinner = logs + changes[1, 100]
    assert hypotheses.compute_misfit(thinner, slow) < 0.1
    other_way = hypotheses.calibration.mean - white @ np.linalg.inv(hypotheses.calibration.whitening)
    assert hypotheses.compute_misfit(other_way, slow) > 1.0


def test_a_set_is_explained_by_a_loss_between_the_few_that_are_tried_first(bank, changes):
    hypotheses = compare(calibrate(bank, draw_sets(11, [])[0]), 40.0 * changes[:1])
    logs = hypotheses.calibration.mean + 40.0 * changes[0, posterior.FEW // 2]
    assert hypotheses.compute_distances(logs, step=posterior.FEW).min() > 100.0
    offset = np.array([0.0, 0.0, 0.0, 30.0, 0.0])
    slow = posterior.SlowDrift().reseat().add(offset, 0.0, hypotheses.calibration.slow)
    assert hypotheses.compute_misfit(logs, slow) < 1e-3


def test_a_set_far_from_all_losses_that_are_possible_leaves_them_so(bank, changes):
    """Likelihoods are over the largest of a possible loss: over that of any they would all be 0."""
    hypotheses = compare(calibrate(bank, draw_sets(11, [])[0]), 40.0 * changes[:1])
    before = state_of([(0.0, 0.0, 0.5), (0.8, 0.0, 0.5)])
    after = add_set(before, hypotheses, hypotheses.calibration.mean + 40.0 * changes[0, 80], 100.0)
    assert after.joint.sum() == pytest.approx(1.0, rel=1e-6)
    assert np.flatnonzero(posterior._sum_by_loss(after)).tolist() in ([0], [160], [0, 160])


def test_a_shift_that_stays_is_less_of_a_loss_than_one_that_grows(bank, changes):
    """A shift by 6 % of loss could be the slow drift; when it grows with time, the wall is more likely."""
    constant, growing = (
        posterior.estimate_loss(run(bank, changes, 12, losses)[-1])
        for losses in (np.full(20, 0.06), np.linspace(0.0, 0.12, 20))
    )
    assert growing.median > constant.median + 0.03


def test_a_sensor_that_scatters_more_is_expected_to_drift_more(bank):
    quiet, _ = draw_sets(11, [])
    loud = SOUND + 1.5 * (quiet - SOUND)
    first, second = calibrate(bank, quiet), calibrate(bank, loud)
    drift, larger = (one.slow / (1.0 - one.slow) for one in (first, second))
    assert 0.5 * SLOW_DRIFT < drift < 2.0 * SLOW_DRIFT
    assert larger / drift == pytest.approx(1.5**4, rel=0.2)  # the square of the ratio of variances
    # The scale of a set has the drift in it: variances grow by 1 + drift.
    ratio = np.linalg.det(first.whitening) / np.linalg.det(second.whitening)
    assert ratio == pytest.approx(1.5**5 * ((1.0 + larger) / (1.0 + drift)) ** 2.5, rel=0.3)


@pytest.mark.parametrize(
    ("logs", "hour"), [(SOUND, 12.0), (np.where(np.arange(5) == 1, np.nan, SOUND), 36.0)], ids=["time", "nan"]
)
def test_a_set_out_of_order_or_without_a_feature_is_refused(bank, changes, logs, hour):
    hypotheses = compare(calibrate(bank, draw_sets(6, [])[0]), changes)
    with pytest.raises(InvalidInputError, match=r"cannot follow hour 24|nan.* each is needed"):
        add_set(begin(len(changes), 24.0), hypotheses, logs, hour)


@pytest.mark.parametrize(
    ("history", "message"),
    [
        (np.zeros((20, 4)), "must be"),
        (draw_sets(7, [])[0][:14], "14 complete sets; a wall thickness needs 15"),
        (
            draw_sets(7, [])[0] + np.log([1e6, 1, 1, 1, 1]),
            "tof_pp_s of the baseline is (1e\\+06|9.99e\\+05) times",
        ),
        (draw_sets(7, [])[0] + np.log([1, 1, 1, 1.4, 1]), "isw_fwhm_s of the baseline is 1.4 times"),
    ],
    ids=["shape", "few", "microseconds", "another chain"],
)
def test_a_baseline_that_the_twin_does_not_explain_is_refused(bank, history, message):
    with pytest.raises(InvalidInputError, match=message):
        calibrate(bank, history)


def test_the_gain_of_a_sensor_is_free(bank):
    louder = draw_sets(8, [])[0] + np.log([1, 1, 1, 1, 3.0])
    assert calibrate(bank, louder).mean[-1] == pytest.approx(np.log(3 * 2.7), abs=0.05)


def state_of(cells, hour=100.0):
    """Return a state with these (loss, rate, probability) and one hypothesis."""
    joint = np.zeros((len(LOSSES), len(RATES_PER_H), 1), dtype=np.float32)
    for loss, rate, probability in cells:
        joint[np.abs(LOSSES - loss).argmin(), np.abs(RATES_PER_H - rate).argmin()] = probability
    return WallState(joint=joint, hour=hour)


def test_a_set_past_the_end_of_every_possible_curve_moves_time_only(bank, changes):
    ended = changes.copy()
    ended[:, 100:] = np.nan
    hypotheses = compare(calibrate(bank, draw_sets(8, [])[0]), ended)
    joint = np.zeros((len(LOSSES), len(RATES_PER_H), len(changes)), dtype=np.float32)
    joint[120, 0] = 1.0 / len(changes)
    before = WallState(joint=joint, hour=100.0)
    after = add_set(before, hypotheses, SOUND, 117.0)
    assert np.array_equal(after.joint, wait(before, 117.0).joint)
    assert after.hour == 117.0


def test_a_forecast_is_the_rest_divided_by_the_rate():
    rate = RATES_PER_H[6]
    certain = posterior.forecast(state_of([(0.1, rate, 1.0)]), 0.3)
    assert certain.median == pytest.approx(0.2 / rate, rel=0.05)
    step = (RATES_PER_H[2] / RATES_PER_H[1]) ** 0.5
    assert 0.2 / rate / step < certain.low < 0.2 / rate < certain.high < 0.2 / rate * step
    assert posterior.forecast(state_of([(0.1, 0.0, 1.0)]), 0.3).median == np.inf
    for rate in (0.0, 1e-3):
        assert posterior.forecast(state_of([(0.6, rate, 1.0)]), 0.3).high == 0.0, "it is reached"


def test_a_predicted_loss_is_the_rate_times_the_hours_and_agrees_with_the_forecast():
    rate = RATES_PER_H[6]
    hours = 0.2 / rate
    later = posterior.predict_loss(state_of([(0.1, rate, 1.0)]), hours)
    step = (RATES_PER_H[2] / RATES_PER_H[1]) ** 0.5
    assert 0.1 + 0.2 / step - 0.03 < later.low < later.median < later.high < 0.1 + 0.2 * step + 0.03
    mixed = state_of([(0.1, rate, 0.5), (0.15, RATES_PER_H[7], 0.3), (0.2, 0.0, 0.2)])
    reached = posterior.forecast(mixed, 0.3)
    assert posterior.predict_loss(mixed, reached.median).median == pytest.approx(0.3, abs=0.002)
    assert posterior.predict_loss(mixed, reached.low).high == pytest.approx(0.3, abs=0.002)
    assert posterior.predict_loss(mixed, 1e6).median == 1.0


def test_the_probability_of_a_limit_counts_the_losses_above_it():
    state = state_of([(0.1, 0.0, 0.75), (0.6, 0.0, 0.25)])
    assert posterior.compute_exceedance(state, 0.3) == pytest.approx(0.25)
    assert posterior.compute_exceedance(state, 0.1) == pytest.approx(0.25 + 0.75 * 10 / 21)
    assert posterior.estimate_rate(state).high == 0.0


def test_a_rate_stays_moves_to_its_neighbors_or_is_drawn_again():
    at_rest, in_the_middle, at_the_end = (
        posterior._move_on(state_of([(0.1, rate, 1.0)], hour=0.0), posterior.CHANGE_H)
        for rate in (0.0, RATES_PER_H[4], RATES_PER_H[-1])
    )
    redrawn, one = posterior.REDRAWN * posterior._RATE_PRIOR, np.eye(len(RATES_PER_H))
    kept, to_each = 1.0 - posterior.REDRAWN, (1.0 - posterior.REDRAWN) * posterior.NEIGHBOR / 2.0
    stays = redrawn + kept * one[0]
    assert np.allclose(at_rest.sum(axis=(0, 2)), stays, atol=1e-6), "nothing but a redraw ends a rest"
    spread = redrawn + to_each * (one[3] + one[5]) + (kept - 2.0 * to_each) * one[4]
    assert np.allclose(in_the_middle.sum(axis=(0, 2)), spread, atol=1e-6)
    last = redrawn + to_each * one[-2] + (kept - to_each) * one[-1]
    assert np.allclose(at_the_end.sum(axis=(0, 2)), last, atol=1e-6)
    sooner = posterior._compute_rate_change(0.25 * posterior.CHANGE_H)
    assert np.allclose(sooner[0], 0.75 * one[0] + 0.25 * stays)


def test_rates_move_losses_exactly_and_probability_stays_one():
    state = state_of([(0.1, 1e-3, 1.0)])
    rate = RATES_PER_H[np.abs(RATES_PER_H - 1e-3).argmin()]
    moved = wait(state, 140.0)
    assert moved.joint.sum() == pytest.approx(1.0, rel=1e-6)
    mean = (moved.joint.sum(axis=(1, 2)) * LOSSES[moved.window]).sum()
    assert mean == pytest.approx(0.1 + 40.0 * rate, rel=1e-5)
    assert wait(state, 1e6).joint[-1].sum() == pytest.approx(1.0, rel=1e-5)


def test_truths_drawn_from_the_prior_have_uniform_ranks(bank, monkeypatch):
    """Simulation-based calibration (Talts et al., 2018) of the untempered filter without ambiguity.

    Truth: hypothesis, rates and losses of the filter's own prior, sets with its own slow drift and scatter,
    and a re-seat that is known.
    """
    monkeypatch.setattr(posterior, "RESEAT_ODDS", 1e-300)
    changes = predict_changes(bank)
    calibration = calibrate(bank, draw_sets(9, [])[0])
    random = np.random.default_rng(20)
    ranks = []
    hypotheses, color = compare(calibration, changes), np.linalg.inv(calibration.whitening)
    rate_change = posterior._compute_rate_change(4.0)
    kept = np.exp(-4.0 / np.array(posterior.MEMORY_H))
    sd = np.sqrt([calibration.slow, posterior.MONTHS, posterior.RESEAT])
    for _ in range(1000):
        hypothesis = random.integers(len(changes))
        rate, cell = random.choice(RATES_PER_H, p=posterior._RATE_PRIOR), 0
        slow = np.array([sd[0] * random.standard_normal(5), np.zeros(5), np.zeros(5)])
        state = begin(len(changes), 0.0)
        for hour in (4.0, 8.0, 12.0, 16.0):
            # Between two losses of the grid the filter shares a probability: it moves to either.
            step = 4.0 * rate / LOSSES[1]
            cell = min(cell + int(step + random.random()), len(LOSSES) - 1)
            rate = random.choice(RATES_PER_H, p=rate_change[np.flatnonzero(rate == RATES_PER_H)[0]])
            moves = (sd * np.sqrt(1.0 - kept**2))[:, None] * random.standard_normal((3, 5))
            slow = kept[:, None] * slow + moves
            if hour == 12.0:
                slow[2] = sd[2] * random.standard_normal(5)
                state = replace(wait(state, hour), slow=state.slow.wait(4.0).reseat())
            t = slow.sum(axis=0) + (1.0 - calibration.slow) ** 0.5 * random.standard_normal(5)
            t /= np.sqrt(random.chisquare(calibration.dof) / calibration.dof)
            logs = calibration.mean + changes[hypothesis, cell] + t @ color
            state = add_set(state, hypotheses, logs, hour, exponent=1.0)
        of_loss = np.zeros(len(LOSSES))
        of_loss[state.window] = state.joint.sum(axis=(1, 2), dtype=float)
        ranks.append(of_loss[:cell].sum() + random.random() * of_loss[cell])
    counts, _ = np.histogram(ranks, bins=10, range=(0.0, 1.0))
    assert stats.chisquare(counts).pvalue > 0.01, counts


def test_a_bank_of_one_curve_without_discrepancy_has_equal_hypotheses(bank):
    one = replace(
        bank,
        changes=bank.changes[:1],
        models=("solid",),
        kinds=("size",),
        sizes_m=bank.sizes_m[:1],
        names=("small",),
    )
    found = predict_changes(one, 0.0, 0.0)
    assert np.array_equal(found[0], found[-1])
    wanted = np.interp(LOSSES, bank.losses, bank.changes[0][:, 0])
    assert np.allclose(found[0, :, 0], wanted)
    assert found.shape == (posterior.SOLID_FACTORS, len(LOSSES), len(FEATURES))


def test_thin_plates_have_the_first_draws_of_the_solids_and_together_about_half_their_probability(bank):
    mixed = predict_changes(replace(bank, models=("mindlin", "solid", "wet_mindlin")))
    few, many = posterior.FACTORS, posterior.SOLID_FACTORS
    assert len(mixed) == few + many + few
    alone = predict_changes(bank)
    assert np.array_equal(mixed[few : few + many], alone[many : 2 * many])
    assert np.array_equal(mixed[:few], alone[:few])
    assert np.array_equal(mixed[-few:], alone[2 * many : 2 * many + few])
    assert np.allclose(np.log(alone[:many, -1, 0] / alone[0, -1, 0]).mean(), 0.0, atol=1e-12), "symmetric"
