"""Wall thickness of a sensor, set after set: the posterior of its loss in meters, with quality and reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from analysis.statistics.rules import AlarmRule, AlarmState, update_alarm_state
from analysis.wall import posterior
from analysis.wall.bank import FEATURES
from analysis.waves.record_reduction import FloatArray

STEP_H = 8.0
"""The filter goes on in steps of at least so many hours, by the mean of their sets: what one of many sets
adds to a stored probability would be lost in its rounding, at a high cost of CPU."""
S_PER_H = 3600.0
HORIZON = 0.25
"""Time of a forecast, as a fraction of the time since the baseline."""
LOST = 0.1
"""Loss of wall whose probability is evidence in the diagnosis, as a fraction."""
ALARM_PROBABILITY = 0.95
"""Probability of a wall below its minimum at which a set counts for the alarm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WallModel:
    """What the sets of a sensor are compared with.

    Attributes
    ----------
    hypotheses
        `posterior.compare`, with the calibration to the sensor's baseline.
    curves
        Name of the curve of each.
    initial_m
        Thickness of the sound wall.
    baseline_h
        Middle of the baseline.
    minimum_m
        Thickness below which the wall must not be; None: none is stated.
    """

    hypotheses: posterior.Hypotheses
    curves: tuple[str, ...]
    initial_m: float
    baseline_h: float
    minimum_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Pool:
    """Mean ln features of the sets since the stored state of the filter, their number, the last hour."""

    mean: tuple[float, ...] = ()
    n: int = 0
    hour: float = 0.0

    def add(self, logs: FloatArray, hour: float) -> Pool:
        """Return the pool with one more set."""
        mean = np.array(self.mean) if self.n else np.zeros(len(logs))
        mean += (logs - mean) / (self.n + 1.0)
        return Pool(mean=tuple(mean.tolist()), n=self.n + 1, hour=hour)


@dataclass(frozen=True, slots=True, kw_only=True)
class WallThickness:
    """Wall thickness after a set; None without an estimate, and ``reason``.

    Attributes
    ----------
    quality
        ``suspect``: the set is diagnosed as one of sensor or coupling, or only an upper end is known;
        ``bad``: no number.
    thickness_m, interval_low_m, interval_high_m
        Median and 90 % interval.
    loss_rate_m_per_s
        Median.
    minimum_m
        Thickness below which the wall must not be; None: none is stated.
    below_minimum_probability
        Probability that the wall is thinner than its minimum.
    time_to_minimum_s, time_to_minimum_low_s
        Until the minimum is reached at the present rate, median and 5 % quantile; None: never.
    forecast_h, forecast_m, forecast_low_m, forecast_high_m
        Hour (`HORIZON`, or when the minimum is reached, if earlier) with the thickness at the present rate:
        median and 90 % interval. None if the wall is below its minimum.
    curve
        Name of the most likely curve of the bank.
    """

    quality: Literal["good", "suspect", "bad"] = "good"
    thickness_m: float | None = None
    interval_low_m: float | None = None
    interval_high_m: float | None = None
    loss_rate_m_per_s: float | None = None
    minimum_m: float | None = None
    below_minimum_probability: float | None = None
    time_to_minimum_s: float | None = None
    time_to_minimum_low_s: float | None = None
    forecast_h: float | None = None
    forecast_m: float | None = None
    forecast_low_m: float | None = None
    forecast_high_m: float | None = None
    curve: str | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WallTrack:
    """What a transducer's assessment keeps of its wall from set to set.

    Attributes
    ----------
    packed
        `posterior.pack_state`, `STEP_H` ago at most.
    pool
        The sets since then.
    baseline_id
        The baseline that ``start`` belongs to.
    start
        Loss of each hypothesis at that baseline, shape (h,); None: the wall was sound.
    alarm
        Of the sets with a wall below the minimum.
    lost_probability
        Of a loss of more than `LOST` since the first baseline; 0 after a renewed one.
    """

    packed: NDArray[np.uint8]
    baseline_id: int
    pool: Pool = Pool()
    start: FloatArray | None = None
    alarm: AlarmState = AlarmState()  # noqa: RUF009 frozen
    lost_probability: float = 0.0

    def unpack(self) -> posterior.WallState:
        """Return the state of the filter."""
        return posterior.unpack_state(self.packed.tobytes())


def pack(state: posterior.WallState) -> NDArray[np.uint8]:
    """Return a state as an array that a `WallTrack` keeps."""
    return np.frombuffer(posterior.pack_state(state), dtype=np.uint8)


def to_logs(values: Mapping[str, float | None]) -> FloatArray:
    """Return the ln features of a set in the order of `bank.FEATURES`; NaN for one that is not above 0."""
    found = [values.get(name) for name in FEATURES]
    return np.array([math.log(value) if value is not None and value > 0.0 else math.nan for value in found])


def find_start(state: posterior.WallState) -> FloatArray:
    """Return the mean loss of each hypothesis, shape (h,): where a new baseline of this wall begins."""
    of_loss, grid = state.joint.sum(axis=1, dtype=np.float64), posterior.LOSSES[state.window]
    total = of_loss.sum(axis=0)
    overall = float(grid @ of_loss.sum(axis=1))
    losses = np.full(len(total), overall)
    np.divide(grid @ of_loss, total, out=losses, where=total > 0.0)
    return losses


def begin_from(changes: FloatArray, start: FloatArray) -> FloatArray:
    """Return the changes of the ln features since a baseline of walls with these losses, NaN past a curve."""
    before = [
        [np.interp(loss, posterior.LOSSES, part) for part in curve.T]
        for loss, curve in zip(start, changes, strict=True)
    ]
    return np.asarray(changes - np.array(before)[:, None, :])


def estimate_thickness(
    model: WallModel,
    state: posterior.WallState,
    pool: Pool,
    logs: FloatArray,
    hour: float,
    *,
    other_cause: str = "",
) -> tuple[posterior.WallState, Pool, WallThickness | None]:
    """Return state and pool after a set with these ln features, and the wall thickness.

    There is one where a step is complete (`STEP_H`), and one of quality ``bad`` where a set cannot be used;
    else None. The state has the digits of a stored one.

    Parameters
    ----------
    other_cause
        Diagnosis of the set, if not the wall: then a re-seat is as likely as none; quality ``suspect``.

    Raises
    ------
    InvalidInputError
        The set is earlier than the state.
    """
    if not np.isfinite(logs).all():
        missing = ", ".join(name for name, value in zip(FEATURES, logs, strict=True) if math.isnan(value))
        return state, pool, WallThickness(quality="bad", reason=f"no value of {missing}")
    misfit = model.hypotheses.compute_misfit(logs, state.slow.wait(hour - state.hour))
    if misfit > 1.0:
        reason = f"not explained by any wall: {misfit:.2g} x the limit. Inspect sensor and contact"
        return state, pool, WallThickness(quality="bad", reason=reason)
    pool = pool.add(logs, hour)
    if hour - state.hour < STEP_H:
        return state, pool, None
    after = posterior.add_set(state, model.hypotheses, np.array(pool.mean), hour, diagnosed=bool(other_cause))
    note = f"diagnosed as a change of the {other_cause}" if other_cause else ""
    state = posterior.round_state(after)
    return state, Pool(), describe_state(state, model, note)


def describe_state(state: posterior.WallState, model: WallModel, note: str = "") -> WallThickness:
    """Return the wall thickness of a state; with a ``note`` on its last set it is ``suspect``."""
    loss, rate = posterior.estimate_loss(state), posterior.estimate_rate(state)
    is_open, initial_m = loss.high > posterior.LARGEST_VALID, model.initial_m
    bound = f"at least {1e3 * initial_m * loss.low:.2f} mm lost" if is_open else ""
    reason = "; ".join(filter(None, (note, bound)))
    limit = None if model.minimum_m is None else 1.0 - model.minimum_m / initial_m
    left = None if limit is None else posterior.forecast(state, limit)
    ahead_h = min(HORIZON * (state.hour - model.baseline_h), math.inf if left is None else left.median)
    later = posterior.predict_loss(state, ahead_h) if ahead_h > 0.0 and not is_open else None
    return WallThickness(
        quality="suspect" if reason else "good",
        thickness_m=None if is_open else initial_m * (1.0 - loss.median),
        interval_low_m=None if is_open else initial_m * (1.0 - loss.high),
        interval_high_m=initial_m * (1.0 - loss.low),
        loss_rate_m_per_s=initial_m * rate.median / S_PER_H,
        minimum_m=model.minimum_m,
        below_minimum_probability=None if limit is None else posterior.compute_exceedance(state, limit),
        time_to_minimum_s=None if left is None or math.isinf(left.median) else S_PER_H * left.median,
        time_to_minimum_low_s=None if left is None or math.isinf(left.low) else S_PER_H * left.low,
        forecast_h=None if later is None else state.hour + ahead_h,
        forecast_m=None if later is None else initial_m * (1.0 - later.median),
        forecast_low_m=None if later is None else initial_m * (1.0 - later.high),
        forecast_high_m=None if later is None else initial_m * (1.0 - later.low),
        curve=posterior.find_likeliest_curve(state, model.curves),
        reason=reason,
    )


def update_alarm(alarm: AlarmState, found: WallThickness | None, rule: AlarmRule) -> AlarmState:
    """Update the k-of-n state of the thickness alarm.

    A set counts as unknown without a probability, or if the minimum is within its interval, above the median.
    """
    below = None if found is None else found.below_minimum_probability
    if below is None or 0.5 < below <= ALARM_PROBABILITY:
        return alarm
    return update_alarm_state(alarm, below > ALARM_PROBABILITY, rule)
