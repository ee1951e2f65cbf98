"""Wall thickness set after set: steps, renewed baselines, re-seats. The bank is the shipped one."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest

from analysis.statistics.rules import AlarmRule, AlarmState
from analysis.wall import estimator as estimator_module
from analysis.wall import posterior
from analysis.wall.bank import FEATURES, load_bank
from analysis.wall.estimator import WallEstimator
from analysis.wall.thickness import HORIZON, STEP_H, Pool, WallThickness, update_alarm
from daq_service.assessment.wall_bank import SHIPPED_BANK

SD = np.array([0.006, 0.03, 0.017, 0.008, 0.05])
SHIFT, NEVER = np.exp([0.03, -0.1, -0.06, 0.05, 0.2]), 1e-300
"""Of the features by a re-seat of the chain, each by 3 to 6 of `SD`; odds of one that is not looked for."""
EVERY_H = 4.0
"""Two sets a step."""


@dataclass(frozen=True)
class SetValues:
    due_h: float
    values: dict[str, float | None]


@pytest.fixture(scope="module")
def opened():
    bank = load_bank(SHIPPED_BANK)
    fields = ("changes", "models", "kinds", "sizes_m", "names")
    bank = replace(bank, **{name: getattr(bank, name)[:6] for name in fields})
    return bank, posterior.predict_changes(bank)


def draw_sets(bank, losses, first_h, seed=3):
    """Return sets each `EVERY_H` h of a sensor on the wall of the bank's first curve, with these losses."""
    noise = SD * np.random.default_rng(seed).standard_normal((len(losses), len(FEATURES)))
    of_wall = [np.interp(losses, bank.losses, part) for part in bank.changes[0].T]
    values = np.exp(bank.sound + noise + np.transpose(of_wall))
    return [
        SetValues(first_h + EVERY_H * k, dict(zip(FEATURES, row.tolist(), strict=True)))
        for k, row in enumerate(values)
    ]


def make_estimator(opened, baseline_id=1, is_first=True, minimum_m=5e-3):
    return WallEstimator(
        lambda: opened, AlarmRule(k=3, n=5), minimum_m, baseline_id=baseline_id, is_first=is_first
    )


def follow(estimator, baseline, sets, track=None):
    found = []
    for one in sets:
        track, thickness = estimator.add_set(track, baseline, one)
        found.append(thickness)
    return track, found


def cover(found, truth_m):
    """Return the part of the intervals that cover the truth."""
    pairs = [(one, truth) for one, truth in zip(found, truth_m, strict=True) if one is not None]
    return np.mean([one.interval_low_m <= truth <= one.interval_high_m for one, truth in pairs])


def test_a_thinning_wall_is_followed_and_its_alarm_raised_below_the_minimum(opened):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    losses = np.minimum(0.4, np.arange(60) / 100.0)
    track, found = follow(make_estimator(opened), baseline, draw_sets(opened[0], losses, 120.0, seed=4))
    truth_m = opened[0].thickness_m * (1.0 - losses)
    assert cover(found, truth_m) > 0.85
    assert {one.quality for one in found[::2]} == {"good"}
    assert track.alarm.active
    assert found[0].below_minimum_probability < 0.01 < 0.95 < found[-2].below_minimum_probability
    assert found[-2].time_to_minimum_s == 0.0
    early, _ = follow(make_estimator(opened), baseline, draw_sets(opened[0], losses[:10], 120.0, seed=4))
    assert early.lost_probability < 0.5 < 0.99 < track.lost_probability


def test_a_forecast_covers_the_wall_at_its_hour_and_ends_where_the_minimum_is_reached(opened):
    baseline, bank = draw_sets(opened[0], np.zeros(30), 0.0), opened[0]
    losses = np.arange(60) / 150.0
    _, found = follow(make_estimator(opened), baseline, draw_sets(bank, losses, 120.0, seed=4))
    hours = 120.0 + EVERY_H * np.arange(60)
    covered, n_early = [], 0
    for hour, one in zip(hours, found, strict=True):
        if one is None:
            continue
        if one.time_to_minimum_s == 0.0:
            assert one.forecast_h is None
            continue
        ahead_h = one.forecast_h - hour
        horizon_h = HORIZON * (hour - np.mean([one.due_h for one in baseline]))
        assert ahead_h == pytest.approx(min(horizon_h, one.time_to_minimum_s / 3600.0))
        if n := ahead_h < horizon_h - 1e-9:
            assert one.forecast_m == pytest.approx(one.minimum_m, abs=0.02e-3)
        n_early += n
        truth_m = bank.thickness_m * (1.0 - np.interp(hour + ahead_h, hours, losses))
        covered.append(one.forecast_low_m <= truth_m <= one.forecast_high_m)
    assert np.mean(covered) > 0.85
    assert n_early > 2


def test_near_sets_are_pooled_and_a_restart_at_any_set_gives_the_same_digits(opened):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    sets = draw_sets(opened[0], np.linspace(0.0, 0.2, 20), 120.0, seed=5)
    estimator = make_estimator(opened)
    track, found = follow(estimator, baseline, sets[:1])
    for one in sets[1:]:
        again = make_estimator(opened).add_set(track, baseline, one)
        track, thickness = estimator.add_set(track, baseline, one)
        assert again[1] == thickness
        assert again[0].pool == track.pool
        assert np.array_equal(again[0].packed, track.packed)
        found.append(thickness)
    sets_a_step = round(STEP_H / EVERY_H)
    assert [one is not None for one in found] == [k % sets_a_step == 0 for k in range(len(sets))]


def test_arrays_that_are_not_kept_are_made_again_with_the_same_digits(opened, monkeypatch):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    sets = draw_sets(opened[0], np.linspace(0.0, 0.2, 6), 120.0, seed=5)
    kept = follow(make_estimator(opened), baseline, sets)
    few = lru_cache(maxsize=2)(lambda _: estimator_module._Arrays())
    monkeypatch.setattr(estimator_module, "_find_arrays", few)
    fleet = [make_estimator(opened) for _ in range(3)]
    followed = [(None, []) for _ in fleet]
    for one in sets:
        for k, (track, found) in enumerate(followed):
            after, thickness = fleet[k].add_set(track, baseline, one)
            followed[k] = after, [*found, thickness]
    for track, found in followed:
        assert found == kept[1]
        assert np.array_equal(track.packed, kept[0].packed)
    assert few.cache_info().misses == len(fleet) * len(sets)


def test_the_mean_of_a_pool_counts_at_the_hour_of_its_last_set():
    pool = Pool().add(np.array([1.0, 2.0]), 3.0).add(np.array([3.0, 6.0]), 5.0).add(np.array([5.0, 4.0]), 7.0)
    assert pool.mean == pytest.approx((3.0, 4.0))
    assert (pool.n, pool.hour) == (3, 7.0)


def test_an_alarm_lasts_while_the_minimum_is_in_the_upper_half_of_the_interval():
    alarm, rule = AlarmState(), AlarmRule(k=3, n=5)
    for probability, active in ((0.7, False), (0.99, True), (0.7, True), (0.3, False)):
        for _ in range(5):
            alarm = update_alarm(alarm, WallThickness(below_minimum_probability=probability), rule)
        assert alarm.active is active


def test_a_set_that_no_wall_explains_gives_no_thickness_and_changes_nothing(opened):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    sets = draw_sets(opened[0], np.full(12, 0.1), 120.0, seed=6)
    estimator = make_estimator(opened)
    track, _ = follow(estimator, baseline, sets)
    later = replace(sets[-1], due_h=sets[-1].due_h + 200.0)
    other = replace(later, values={**later.values, "amplitude_ratio": 0.2})
    after, unexplained = estimator.add_set(track, baseline, other, "coupling")
    assert unexplained.quality == "bad"
    assert unexplained.thickness_m is None
    assert "not explained by any wall" in unexplained.reason
    assert (after.packed is track.packed, after.pool, after.alarm) == (True, track.pool, track.alarm)


def test_a_set_with_another_diagnosis_has_a_thickness_that_is_suspect(opened):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    one = draw_sets(opened[0], np.zeros(1), 120.0, seed=6)[0]
    (_, plain), (_, suspect) = (
        make_estimator(opened).add_set(None, baseline, one, cause) for cause in ("", "sensor")
    )
    assert suspect == replace(plain, quality="suspect", reason="diagnosed as a change of the sensor")


def test_a_reseated_chain_widens_the_interval_and_its_wall_is_followed(opened, monkeypatch):
    """The shift is that of a tenth of the wall, and one of the incident wave."""
    baseline, bank = draw_sets(opened[0], np.zeros(30), 0.0), opened[0]
    healthy = draw_sets(bank, np.zeros(30), 120.0, seed=4)
    losses = np.concatenate([np.zeros(30), np.linspace(0.0, 0.5, 50)])
    shifted = [
        replace(one, values={name: one.values[name] * SHIFT[k] for k, name in enumerate(FEATURES)})
        for one in draw_sets(bank, losses, 240.0, seed=5)
    ]
    truth_m = bank.thickness_m * (1.0 - losses)
    found = {}
    for odds in (posterior.RESEAT_ODDS, NEVER):
        monkeypatch.setattr(posterior, "RESEAT_ODDS", odds)
        found[odds] = follow(make_estimator(opened), baseline, [*healthy, *shifted])[1]
    before, (known, unknown) = found[NEVER][28], (rows[30:] for rows in found.values())
    assert known[28].interval_high_m == bank.thickness_m > unknown[28].interval_high_m
    assert cover(known, truth_m) > 0.85 > 0.6 > cover(unknown, truth_m)
    assert known[-2].below_minimum_probability > 0.95
    assert known[28].interval_low_m < before.interval_low_m


def test_a_missing_feature_gives_no_thickness_and_changes_nothing(opened):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    sets = draw_sets(opened[0], np.zeros(2), 120.0, seed=7)
    estimator = make_estimator(opened)
    track, _ = follow(estimator, baseline, sets[:1])
    lacking = replace(sets[1], values={**sets[1].values, "amplitude_ratio": None})
    after, thickness = estimator.add_set(track, baseline, lacking)
    assert thickness.reason == "no value of amplitude_ratio"
    assert (after.packed is track.packed, after.pool) == (True, track.pool)


def test_a_renewed_baseline_keeps_the_loss_reached_so_far(opened):
    """The new baseline's sets show no change: without the earlier loss the wall would be sound again."""
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    thinning = draw_sets(opened[0], np.minimum(0.3, np.arange(50) / 100.0), 120.0, seed=8)
    track, found = follow(make_estimator(opened), baseline, thinning)
    renewed = draw_sets(opened[0], np.full(30, 0.3), 330.0, seed=9)
    later = draw_sets(opened[0], np.linspace(0.3, 0.45, 40), 450.0, seed=10)
    track, after = follow(make_estimator(opened, baseline_id=5, is_first=False), renewed, later, track)
    assert track.baseline_id == 5
    assert track.lost_probability == 0.0  # a diagnosis is of the change since the baseline
    truth_m = opened[0].thickness_m * (1.0 - np.linspace(0.3, 0.45, 40))
    assert abs(after[0].thickness_m - found[-2].thickness_m) < 0.5e-3
    assert cover(after, truth_m) > 0.85


@pytest.mark.parametrize(
    ("is_first", "factor", "reason"),
    [
        (False, 1.0, "the loss at the renewed baseline is not known"),
        (True, 1e6, "tof_pp_s of the baseline is 9.9"),
    ],
    ids=["renewed without a track", "microseconds"],
)
def test_a_baseline_that_cannot_be_used_is_refused_with_each_set(opened, is_first, factor, reason):
    baseline = [
        replace(one, values={**one.values, FEATURES[0]: factor * one.values[FEATURES[0]]})
        for one in draw_sets(opened[0], np.zeros(30), 0.0)
    ]
    sets = draw_sets(opened[0], np.zeros(2), 120.0)
    track, found = follow(make_estimator(opened, is_first=is_first), baseline, sets)
    assert track is None
    assert all(one.quality == "bad" and one.thickness_m is None for one in found)
    assert all(one.reason.startswith(reason) for one in found), found[0].reason


def test_without_a_bank_there_is_no_row_until_it_is_built(opened):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    sets = draw_sets(opened[0], np.zeros(3), 120.0)
    built = []
    estimator = WallEstimator(
        lambda: built[0] if built else None, AlarmRule(), None, baseline_id=1, is_first=True
    )
    assert estimator.add_set(None, baseline, sets[0]) == (None, None)
    built.append(opened)
    track, thickness = estimator.add_set(None, baseline, sets[1])
    assert track is not None
    assert thickness.quality == "good"
    assert thickness.below_minimum_probability is None


def test_a_stored_wall_of_another_bank_is_refused_with_each_set(opened):
    baseline = draw_sets(opened[0], np.zeros(30), 0.0)
    sets = draw_sets(opened[0], np.zeros(3), 120.0)
    track, _ = follow(make_estimator(opened), baseline, sets[:1])
    fewer = WallEstimator(
        lambda: (opened[0], opened[1][:-1]), AlarmRule(), None, baseline_id=1, is_first=True
    )
    after, found = follow(fewer, baseline, sets[1:], track)
    assert after is track
    assert all(one.quality == "bad" and one.thickness_m is None for one in found)
    assert "hypotheses, those of this version are" in found[0].reason
