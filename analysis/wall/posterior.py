"""Loss of wall after each set: a filter on a grid of loss and rate for each hypothesis about the wall.

A hypothesis is a curve of the bank, with factors that stay the same for a sensor: how far curves of the twin
may be off (the discrepancy). For each the filter is exact: the loss never decreases, the rate stays or is
drawn again. Sets are correlated, so their likelihood counts by the exponent `TEMPER`. What curves that fit
equally well disagree about widens the result (`AMBIGUITY`), not the likelihood. All constants were chosen on
even seeds of `benchmarks/wall_thickness.py` and are shown on odd ones (decision 0069).
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f, norm, qmc

from analysis.errors import InvalidInputError
from analysis.wall.bank import FEATURES, Bank
from analysis.wall.calibration import Calibration
from analysis.waves.record_reduction import FloatArray

LOSSES = np.arange(161) / 200.0
"""Grid of the loss: 0 to 0.8 of the wall."""
LARGEST_VALID = 0.75
"""Loss beyond which an interval is not valid: only its lower end is stated."""
RATES_PER_H = np.concatenate([[0.0], np.geomspace(1e-5, 1e-2, 9)])
"""Relative loss per hour: of a 6.35-mm wall 0.56 mm per year to 1.5 mm per day; slower ones lie between 0 and
the smallest."""
STILL = 0.05
"""Prior probability of the rate 0; the others are equally likely."""
NEIGHBOR, REDRAWN = 0.3, 0.02
"""Probabilities that the rate moves to a neighbor on its grid, or is drawn again, between two sets."""
TEMPER = 0.35
"""Exponent of a set's likelihood."""
FACTORS = 4
FACTOR_SD, RATIO_SD = 0.15, 0.05
"""Discrepancy: SD of the ln factor of a feature's change, and of ln AR itself at half of the wall."""
AMBIGUITY = 0.10
"""Standard deviation of the result, as a fraction of the loss."""
OF_WALL = 3
"""Features that the wall changes, the first ones: the incident wave is before it."""
AR = FEATURES.index("amplitude_ratio")
QUANTILES = (0.05, 0.5, 0.95)
LEAST = 1e-5
"""Probability of a cell, of the largest one's, below which it is left out: less than 0.5 % together."""
GRAINS = 255
"""Steps of the logarithm in which a stored state keeps probabilities: 2 % each."""
MISFIT_RATE = 1e-4
"""Rate at which a set of an unchanged sensor is taken for one that no hypothesis explains."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WallState:
    """Joint probability of hypothesis, loss and rate after a set, shape (h, 161, 10); sum 1."""

    joint: NDArray[np.float32]
    hour: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantiles:
    """Quantiles 5, 50 and 95 % of a quantity."""

    low: float
    median: float
    high: float


def predict_changes(
    bank: Bank, factor_sd: float = FACTOR_SD, ratio_sd: float = RATIO_SD
) -> NDArray[np.float64]:
    """Return the changes of the ln features by hypothesis and loss, shape (h, 161, 5); NaN past a curve.

    A hypothesis is a curve with one of `FACTORS` draws of the discrepancy (a Sobol sequence).
    """
    curves = np.array(
        [
            [np.interp(LOSSES, bank.losses, part, right=math.nan) for part in member.T]
            for member in bank.changes
        ]
    ).transpose(0, 2, 1)
    uniform = qmc.Sobol(OF_WALL + 1, scramble=False).random(2 * FACTORS)[1 : FACTORS + 1]
    normal = norm.ppf(uniform)
    factors = np.ones((FACTORS, len(FEATURES)))
    factors[:, :OF_WALL] = np.exp(factor_sd * normal[:, :-1])
    changes = curves[:, None] * factors[:, None]
    changes[..., AR] += ratio_sd * normal[:, -1:] * LOSSES / 0.5
    return np.asarray(changes.reshape(-1, len(LOSSES), len(FEATURES)))


def begin(n_hypotheses: int, hour: float) -> WallState:
    """Return the state at the end of a baseline: no loss, all hypotheses equally likely."""
    joint = np.zeros((n_hypotheses, len(LOSSES), len(RATES_PER_H)), dtype=np.float32)
    joint[:, 0] = _RATE_PRIOR / n_hypotheses
    return WallState(joint=joint, hour=hour)


def add_set(
    state: WallState,
    calibration: Calibration,
    changes: FloatArray,
    logs: FloatArray,
    hour: float,
    temper: float = TEMPER,
) -> tuple[WallState, float]:
    """Update a state by the ln features of a set, shape (5,), at an hour of the test.

    Parameters
    ----------
    changes
        From `predict_changes`.

    Returns
    -------
    state, misfit
        ``misfit`` is the smallest distance squared from any hypothesis and loss, divided by the limit that an
        unchanged sensor exceeds at the rate `MISFIT_RATE`. Above 1 nothing explains the set: the state only
        moves on in time.

    Raises
    ------
    InvalidInputError
        The set is earlier than the state, or a feature is missing.
    """
    if hour < state.hour or not np.isfinite(logs).all():
        raise InvalidInputError(
            f"a set at hour {hour:g} with ln features {logs.tolist()} cannot follow hour {state.hour:g}; the "
            "order is that of time, and each feature is needed"
        )
    moved = _move_on(state, hour - state.hour)
    white = (logs - calibration.mean - changes) @ calibration.whitening
    distance = np.nan_to_num(np.einsum("hlf,hlf->hl", white, white), nan=np.inf)
    p = len(FEATURES)
    misfit = float(distance.min()) / (p * float(f.isf(MISFIT_RATE, p, calibration.dof)))
    if misfit <= 1.0:
        evidence = -0.5 * temper * (calibration.dof + p) * np.log1p(distance / calibration.dof)
        moved *= np.exp(evidence - evidence.max())[:, :, None].astype(np.float32)
    return WallState(joint=_round(moved / moved.sum()), hour=hour), misfit


def estimate_loss(state: WallState, ambiguity: float = AMBIGUITY) -> Quantiles:
    """Return the loss of wall as a fraction of the wall at the baseline."""
    of_loss = state.joint.sum(axis=(0, 2), dtype=np.float64)
    spread = 1.0 + ambiguity / AMBIGUITY * (_SPREAD - 1.0)
    # A loss of the grid stands for the interval around it; 0 is the sound wall.
    cells = np.maximum(LOSSES[:, None] + LOSSES[1] * _IN_CELL * (LOSSES[:, None] > 0.0), 0.0)
    values = cells[:, :, None] * spread
    weights = np.broadcast_to(of_loss[:, None, None], values.shape) / (len(_IN_CELL) * len(spread))
    return _find_quantiles(values, weights)


def estimate_rate(state: WallState) -> Quantiles:
    """Return the rate of loss per hour, as a fraction of the wall at the baseline."""
    return _find_quantiles(RATES_PER_H, state.joint.sum(axis=(0, 1), dtype=np.float64))


def forecast(state: WallState, loss: float) -> Quantiles:
    """Return the hours from the state's set until a loss is reached; 0: it is reached, infinite: never.

    The rate stays as it is.
    """
    joint = state.joint.sum(axis=0, dtype=np.float64)
    # Rates are points of a logarithmic grid: each stands for the interval around it.
    step = (RATES_PER_H[2] / RATES_PER_H[1]) ** _IN_CELL
    left = np.clip(loss - LOSSES[:, None] * _SPREAD, 0.0, None)
    with np.errstate(divide="ignore", invalid="ignore"):
        hours = left[:, :, None, None] / (RATES_PER_H[:, None] * step)
    hours[left == 0.0] = 0.0
    weights = joint[:, None, :, None] * _SPREAD_WEIGHTS[:, None, None] / len(step)
    return _find_quantiles(hours, np.broadcast_to(weights, hours.shape))


def compute_exceedance(state: WallState, loss: float) -> float:
    """Return the probability that the loss is larger than a limit."""
    of_loss = state.joint.sum(axis=(0, 2), dtype=np.float64)
    return float((np.outer(of_loss, _SPREAD_WEIGHTS) * (LOSSES[:, None] * _SPREAD > loss)).sum())


def pack_state(state: WallState) -> bytes:
    """Return a state in some ten to 200 kB; `unpack_state` returns exactly the same state."""
    grains = _find_grains(state.joint)
    return zlib.compress(np.float64(state.hour).tobytes() + grains.tobytes(), 6)


def unpack_state(packed: bytes) -> WallState:
    """Return the state that `pack_state` packed; raise InvalidInputError for other bytes."""
    try:
        content = zlib.decompress(packed)
        grains = np.frombuffer(content, dtype=np.uint8, offset=8)
        grains = grains.reshape(-1, len(LOSSES), len(RATES_PER_H))
    except (zlib.error, ValueError) as error:
        raise InvalidInputError(f"{len(packed)} bytes are no state of a wall ({error})") from error
    return WallState(joint=_to_probabilities(grains), hour=float(np.frombuffer(content[:8])[0]))


def _move_on(state: WallState, hours: float) -> NDArray[np.float32]:
    """Return the joint probability after some hours: each rate moves its losses; then the rate may change."""
    moved, n = np.zeros_like(state.joint), len(LOSSES)
    for index, rate in enumerate(RATES_PER_H.tolist()):
        cells = min(rate * hours / float(LOSSES[1]), n - 1.0)
        whole, part = int(cells), np.float32(cells % 1.0)
        before, after = state.joint[:, :, index], moved[:, :, index]
        after[:, whole:] += (1 - part) * before[:, : n - whole]
        after[:, whole + 1 :] += part * before[:, : max(n - whole - 1, 0)]
        after[:, -1] += before.sum(axis=1) - after.sum(axis=1)  # past the grid's end
    return np.asarray(moved @ _RATE_CHANGE.astype(np.float32))


def _round(joint: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return probabilities as a stored state has them: a restart goes on with the same digits."""
    return _to_probabilities(_find_grains(joint))


def _find_grains(joint: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the logarithms of probabilities in `GRAINS` steps below the largest; 0: less than `LEAST`."""
    ratio = joint / joint.max()
    steps = np.rint(GRAINS + (GRAINS - 1) / -math.log(LEAST) * np.log(np.maximum(ratio, LEAST)))
    return np.where(ratio < LEAST, 0, steps).astype(np.uint8)


def _to_probabilities(grains: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the probabilities that grains stand for, with sum 1."""
    joint = _OF_GRAINS[grains]
    return np.asarray(joint / joint.sum(dtype=np.float64), dtype=np.float32)


def _find_quantiles(values: FloatArray, weights: FloatArray) -> Quantiles:
    """Return the weighted quantiles; each is one of the values, whose weight counts half below it."""
    possible = weights > 0.0
    order = np.argsort(values[possible], kind="stable")
    ordered, weight = values[possible][order], weights[possible][order]
    middle = np.cumsum(weight) - 0.5 * weight
    low, median, high = ordered[np.minimum(np.searchsorted(middle, QUANTILES), len(ordered) - 1)].tolist()
    return Quantiles(low=low, median=median, high=high)


_RATE_PRIOR = np.full(len(RATES_PER_H), (1.0 - STILL) / (len(RATES_PER_H) - 1))
_RATE_PRIOR[0] = STILL
_STEPS = np.eye(len(RATES_PER_H) - 1, k=1) + np.eye(len(RATES_PER_H) - 1, k=-1)
_TO_NEIGHBOR = 0.5 * NEIGHBOR * np.pad(_STEPS, (1, 0))
_KEPT_RATE = np.diag(1.0 - _TO_NEIGHBOR.sum(axis=1))
_RATE_CHANGE = (1.0 - REDRAWN) * (_KEPT_RATE + _TO_NEIGHBOR) + REDRAWN * _RATE_PRIOR
"""Probability of the next rate by the present one; the rate 0 has no neighbor."""
_IN_CELL = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])
_SPREAD_WEIGHTS = np.full(21, 1.0 / 21.0)
_SPREAD = 1.0 + AMBIGUITY * norm.ppf((np.arange(21) + 0.5) / 21.0)
"""Points of equal probability of the ambiguity, as factors of a loss."""
_OF_GRAINS = np.exp(-math.log(LEAST) * (np.arange(GRAINS + 1) - GRAINS) / (GRAINS - 1)).astype(np.float32)
_OF_GRAINS[0] = 0.0
