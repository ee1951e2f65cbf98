"""Loss of wall after each set: a filter on a grid of loss and rate for each hypothesis about the wall.

A hypothesis is a curve of the bank, with factors that stay the same for a sensor: how far curves of the twin
may be off (the discrepancy). For each the filter is exact: the loss never decreases, the rate stays or is
drawn again. Sets share a slow drift of the sensor, which each hypothesis estimates (`SlowDrift`). What
curves that fit equally well disagree about widens the result (`AMBIGUITY`), not the likelihood. Constants
were chosen on even seeds of `benchmarks/wall_thickness.py` and are shown on odd ones (decision 0069), those
of a re-seat on other sensors (`benchmarks/wall_reseats.py`).
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field, replace
from functools import lru_cache
from statistics import NormalDist

import numpy as np
import scipy  # its parts come when asked for: they are slow to import
from numpy.typing import NDArray

from analysis.errors import InvalidInputError
from analysis.wall.bank import FEATURES, Bank
from analysis.wall.calibration import Calibration
from analysis.waves.record_reduction import FloatArray

LOSSES = np.arange(161) / 200.0
"""Grid of the loss: 0 to 0.8 of the wall."""
LARGEST_VALID = 0.75
"""Loss beyond which an interval is not valid: only its lower end is stated."""
RATES_PER_H = np.concatenate([[0.0], np.geomspace(1e-5, 1e-2, 14)])
"""Relative loss per hour: of a 6.35-mm wall 0.56 mm per year to 1.5 mm per day; slower ones lie between 0 and
the smallest."""
STILL, TILT = 0.05, 0.5
"""Prior probability of the rate 0; that of the others goes with this power of the rate: between equal ones on
a scale of the logarithm and on one of the rate."""
NEIGHBOR, REDRAWN, CHANGE_H = 0.8, 0.02, 17.0
"""Probabilities that the rate moves to a neighbor on its grid, or is drawn again, within `CHANGE_H`."""
MEMORY_H, MONTHS = (150.0, 2500.0, math.inf), 1.5
"""Correlation times of the slow drift of days (`Calibration.slow`) and of that of months, and the variance of
the latter in those of a set: healthy sets over a year at three levels of the twin, even seeds. What a re-seat
of the chain adds stays."""
RESEAT, RESEAT_ODDS, DIAGNOSED_ODDS = 4.0, 0.01, 1.0
"""Variance that a re-seat of the chain adds, in those of a set; its prior odds in a step, and in one with a
set that is diagnosed as a change of sensor or coupling."""
TEMPER = 0.8
"""Exponent of a set's likelihood."""
FACTORS, SOLID_FACTORS = 3, 15
"""Draws of the discrepancy per curve of thin plates and of solids. A hypothesis is as likely as another one:
about half of the probability is that of the solids, the main model."""
FACTOR_SD, RATIO_SD = 0.2, 0.06
"""Discrepancy: SD of the ln factor of a feature's change, and of ln AR itself at half of the wall."""
AMBIGUITY = 0.13
"""Standard deviation of the result, as a fraction of the loss."""
SOBOL = np.array(
    [
        [8, 12, 4, 6, 14, 10, 2, 3, 11, 15, 7, 5, 13, 9, 1],
        [8, 4, 12, 6, 14, 2, 10, 5, 13, 1, 9, 3, 11, 7, 15],
        [8, 4, 12, 10, 2, 14, 6, 15, 7, 11, 3, 5, 13, 1, 9],
        [8, 4, 12, 14, 6, 10, 2, 7, 15, 3, 11, 9, 1, 13, 5],
    ]
).T
"""First points of the Sobol sequence in four dimensions, in sixteenths: normal factors of a discrepancy."""
FORECAST_CELLS = 2000
"""To which forecast losses are rounded: to sort them takes three times as long."""
OF_WALL = 3
"""Features that the wall changes, the first ones: the incident wave is before it."""
AR = FEATURES.index("amplitude_ratio")
QUANTILES = (0.05, 0.5, 0.95)
IMPOSSIBLE = 1e30
"""Squared distance of a cell that is not possible."""
LEAST = 1e-4
"""Probability of a cell, of the largest one's, below which it is left out."""
GRAINS = 51
"""Steps of the logarithm in which a stored state keeps probabilities: 20 % each."""
PARTS = len(MEMORY_H)
"""Of the slow drift."""
MOST_CELLS = 420_000
"""Cells of a stored state, the most probable ones: some 180 kB."""
HEAD = 4 + PARTS * (len(FEATURES) + 2) + PARTS**2
"""Numbers before the probabilities in a stored state."""
FEW = 10
"""One loss in so many is enough to explain most sets, at a sixth of the time."""
MISFIT_RATE = 1e-4
"""Rate at which a set of an unchanged sensor is taken for one that no hypothesis explains."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlowDrift:
    """Change of a sensor's features that later sets share: a Kalman filter, in whitened units.

    It has three parts: the drift of days; that of months, which begins at 0 with the baseline; re-seats.

    Attributes
    ----------
    estimate
        Weighted sums over the sets, shape (3, 7): of the whitened features, of 1, of the hour.
    explained
        Covariance of the parts that is explained, shape (3, 3); negative for what a re-seat added.
    """

    estimate: FloatArray = field(default_factory=lambda: np.zeros((PARTS, len(FEATURES) + 2)))
    explained: FloatArray = field(default_factory=lambda: np.diag([0.0, MONTHS, 0.0]))

    def wait(self, hours: float) -> SlowDrift:
        """Return the estimate after some hours without a set."""
        kept = np.exp(-hours / np.array(MEMORY_H))
        return SlowDrift(
            estimate=kept[:, None] * self.estimate, explained=np.outer(kept, kept) * self.explained
        )

    def compute_variance(self, slow: float) -> FloatArray:
        """Return the covariance of the parts, shape (3, 3); ``slow``: variance of the first one."""
        return np.asarray(np.diag([slow, MONTHS, 0.0]) - self.explained)

    def reseat(self) -> SlowDrift:
        """Return the estimate after a re-seat of the chain."""
        return replace(self, explained=self.explained - np.diag([0.0, 0.0, RESEAT]))

    def add(self, white: FloatArray, hour: float, slow: float) -> SlowDrift:
        """Return the estimate after a set with these whitened features."""
        with_sum = self.compute_variance(slow).sum(axis=1)
        variance = with_sum.sum() + 1.0 - slow
        rest = np.array([*white.tolist(), 1.0, hour]) - self.estimate.sum(axis=0)
        return SlowDrift(
            estimate=self.estimate + np.outer(with_sum / variance, rest),
            explained=self.explained + np.outer(with_sum, with_sum) / variance,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WallState:
    """Probabilities after a set.

    Attributes
    ----------
    joint
        Joint probability of loss, rate and hypothesis, shape (w, 15, h); sum 1.
    first
        Index of its first loss on the grid; no other one is possible.
    grains
        Logarithms of ``joint`` as they are stored (`_find_grains`); None: it is not rounded to these.
    """

    joint: NDArray[np.float32]
    hour: float
    first: int = 0
    slow: SlowDrift = field(default_factory=SlowDrift)
    grains: NDArray[np.uint8] | None = None

    @property
    def window(self) -> slice:
        """Return the place of ``joint`` on the grid of the loss."""
        return slice(self.first, self.first + len(self.joint))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypotheses:
    """Walls that the sets of a sensor are compared with.

    Attributes
    ----------
    white
        Changes of the ln features since the baseline by feature, loss and hypothesis, in whitened units,
        shape (5, 161, h); 0 past a curve.
    norm
        Square of each, shape (161, h); infinite past a curve.
    """

    calibration: Calibration
    white: NDArray[np.float32]
    norm: NDArray[np.float32]

    def compute_distances(
        self, logs: FloatArray, offset: FloatArray | float = 0.0, step: int = 1
    ) -> FloatArray:
        """Return the squared distances of a set from each loss and hypothesis, shape (161, h).

        ``offset``, in whitened units, is taken from the set; with a ``step`` only every so many losses count.
        """
        set_white = (logs - self.calibration.mean) @ self.calibration.whitening - offset
        distances = np.tensordot((-2.0 * set_white).astype(np.float32), self.white[:, ::step], 1)
        distances += self.norm[::step]
        distances += np.float32(set_white @ set_white)
        return np.asarray(np.maximum(distances, 0.0, out=distances))

    def compute_misfit(self, logs: FloatArray, slow: SlowDrift) -> float:
        """Return the smallest distance from any hypothesis and loss, over the limit of an unchanged sensor.

        That sensor exceeds it at the rate `MISFIT_RATE`; above 1 no wall explains the set, neither alone nor
        with the offset that ``slow`` has estimated. Where few losses (`FEW`) explain it, only these count.
        """
        p = len(FEATURES)
        limit = p * float(scipy.special.fdtri(p, self.calibration.dof, 1.0 - MISFIT_RATE))
        nearest = float(self.compute_distances(logs, step=FEW).min())
        if nearest > limit:
            nearest = float(self.compute_distances(logs).min())
        if nearest > limit:
            offset = slow.estimate.sum(axis=0)[:p]
            nearest = min(nearest, float(self.compute_distances(logs, offset).min()))
        return nearest / limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantiles:
    """Quantiles 5, 50 and 95 % of a quantity."""

    low: float
    median: float
    high: float


def _to_normal(probabilities: NDArray[np.floating]) -> FloatArray:
    """Return the quantiles of the standard normal distribution."""
    quantiles = [NormalDist().inv_cdf(one) for one in probabilities.ravel().tolist()]
    return np.array(quantiles).reshape(probabilities.shape)


def predict_changes(
    bank: Bank, factor_sd: float = FACTOR_SD, ratio_sd: float = RATIO_SD
) -> NDArray[np.float64]:
    """Return the changes of the ln features by hypothesis and loss, shape (h, 161, 5); NaN past a curve.

    A hypothesis is a curve with one of its draws of the discrepancy (a Sobol sequence).
    """
    curves = np.array(
        [
            [np.interp(LOSSES, bank.losses, part, right=math.nan) for part in member.T]
            for member in bank.changes
        ]
    ).transpose(0, 2, 1)
    normal = _to_normal(SOBOL / (SOLID_FACTORS + 1.0))
    factors = np.ones((SOLID_FACTORS, 1, len(FEATURES)))
    factors[:, 0, :OF_WALL] = np.exp(factor_sd * normal[:, :-1])
    shift = np.zeros((SOLID_FACTORS, len(LOSSES), len(FEATURES)))
    shift[..., AR] = ratio_sd * normal[:, -1:] * LOSSES / 0.5
    draws = zip(curves, _count_draws(bank), strict=True)
    changes = np.concatenate([curve * factors[:n] + shift[:n] for curve, n in draws])
    return np.asfortranarray(changes)  # `compare` takes 40 % of the time


def _count_draws(bank: Bank) -> list[int]:
    """Return the number of draws of each curve."""
    return [SOLID_FACTORS if model == "solid" else FACTORS for model in bank.models]


def list_curves(bank: Bank) -> tuple[str, ...]:
    """Return the name of the curve of each hypothesis, in their order."""
    return tuple(np.repeat(bank.names, _count_draws(bank)).tolist())


def find_likeliest_curve(state: WallState, curves: tuple[str, ...]) -> str:
    """Return the name of the curve that is most probable in all its hypotheses (`list_curves`)."""
    names, index = np.unique(curves, return_inverse=True)
    weights = np.bincount(index, state.joint.sum(axis=(0, 1)))
    return str(names[weights.argmax()])


def compare(calibration: Calibration, changes: FloatArray) -> Hypotheses:
    """Return the hypotheses with these changes (`predict_changes`) for a calibrated sensor."""
    white = np.tensordot(calibration.whitening.T, changes.T, 1).astype(np.float32)
    norm = np.einsum("flh,flh->lh", white, white)
    past = np.isnan(norm)
    white[:, past], norm[past] = 0.0, np.inf
    return Hypotheses(calibration=calibration, white=white, norm=norm)


def begin(n_hypotheses: int, hour: float) -> WallState:
    """Return the state at the end of a baseline: no loss, all hypotheses equally likely."""
    joint = np.tile(_RATE_PRIOR[None, :, None] / n_hypotheses, n_hypotheses)
    return WallState(joint=joint.astype(np.float32), hour=hour)


def add_set(
    state: WallState,
    hypotheses: Hypotheses,
    logs: FloatArray,
    hour: float,
    exponent: float = TEMPER,
    *,
    diagnosed: bool = False,
) -> WallState:
    """Update a state by the ln features of a set, shape (5,), at an hour of the test.

    Parameters
    ----------
    exponent
        Of the likelihood.
    diagnosed
        The set is diagnosed as a change of sensor or coupling.

    Raises
    ------
    InvalidInputError
        The set is earlier than the state, or a feature is missing.
    """
    if not np.isfinite(logs).all():
        raise InvalidInputError(f"ln features {logs.tolist()} of the set at hour {hour:g}: each is needed")
    before = _move_on(state, hour)
    losses = np.arange(state.first, state.first + len(before))
    calibration, slow = hypotheses.calibration, state.slow.wait(hour - state.hour)
    set_white = (logs - calibration.mean) @ calibration.whitening
    # Variance of the set about its prediction.
    variance = slow.compute_variance(calibration.slow).sum() + 1.0 - calibration.slow
    *offset, share, at = slow.estimate.sum(axis=0).tolist()
    before *= np.isfinite(hypotheses.norm[losses])[:, None]
    if not before.any():  # each is past its curve: the set excludes none of them
        return wait(state, hour)
    rest = (set_white - offset).astype(np.float32)[:, None, None] - hypotheses.white[:, losses]
    square, of_white = np.einsum("flh,flh->lh", rest, rest), np.nan_to_num(hypotheses.norm, posinf=0.0)
    # What a hypothesis takes for the slow drift follows from its loss at an earlier hour.
    hours = hour - at / share if share else 0.0
    cells = np.rint(np.minimum(RATES_PER_H * hours / LOSSES[1], len(LOSSES))).astype(int)
    squares = np.float32(IMPOSSIBLE) * (before == 0.0)
    for passed in set(cells.tolist()):
        earlier = np.maximum(losses - passed, 0)
        # The square of rest + share * white, without an array of that sum.
        along = np.einsum("flh,flh->lh", rest, hypotheses.white[:, earlier])
        added = np.float32(2.0 * share) * along + np.float32(share**2) * of_white[earlier]
        squares[:, cells == passed] += (square + added)[:, None]
    evidence, density = _compute_evidence(before, squares, variance, calibration.dof)
    log_odds = math.log(DIAGNOSED_ODDS if diagnosed else RESEAT_ODDS)
    # At most, after a re-seat: all probability at the nearest cell. That mostly saves the rest.
    nearest = np.ones(1, dtype=np.float32), squares.min(keepdims=True).ravel()
    if _compute_evidence(*nearest, variance + RESEAT, calibration.dof)[1] + log_odds > density:
        reseated, density_reseated = _compute_evidence(before, squares, variance + RESEAT, calibration.dof)
        if density_reseated + log_odds > density:
            slow, evidence = slow.reseat(), reseated
    evidence *= np.float32(exponent)
    before *= np.exp(evidence, out=evidence)
    return _keep(state.first, before, hour, slow.add(set_white, hour, calibration.slow))


def _compute_evidence(
    before: NDArray[np.float32], squares: NDArray[np.float32], variance: float, dof: float
) -> tuple[NDArray[np.float32], float]:
    """Return the ln likelihood of a set by cell, below the largest one, and the ln of the mean likelihood.

    The latter but for a constant of all sets.
    """
    evidence = squares / np.float32(variance * dof)
    evidence += 1.0
    np.log(evidence, out=evidence)
    evidence *= np.float32(-0.5 * (dof + len(FEATURES)))
    largest = float(evidence.max())
    evidence -= np.float32(largest)
    mean = float(np.vdot(before, np.exp(evidence)))
    return evidence, largest + math.log(mean) - 0.5 * len(FEATURES) * math.log(variance)


def wait(state: WallState, hour: float) -> WallState:
    """Return the state at a later hour without a set; raise InvalidInputError for an earlier one."""
    return _keep(state.first, _move_on(state, hour), hour, state.slow.wait(hour - state.hour))


def estimate_loss(state: WallState, ambiguity: float = AMBIGUITY) -> Quantiles:
    """Return the loss of wall as a fraction of the wall at the baseline."""
    values, index = _spread_losses(ambiguity)
    return _take_quantiles(values, _sum_by_loss(state)[index])


@lru_cache(maxsize=4)
def _spread_losses(ambiguity: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the values that stand for the losses of the grid, in order, and the loss of each.

    A loss stands for the interval around it, with its ambiguity; 0 is the sound wall.
    """
    cells = np.maximum(LOSSES[:, None] + LOSSES[1] * _IN_CELL * (LOSSES[:, None] > 0.0), 0.0)
    values = cells[:, :, None] * (1.0 + ambiguity / AMBIGUITY * (_SPREAD - 1.0))
    order = np.argsort(values, axis=None, kind="stable")
    return values.ravel()[order], order // (len(_IN_CELL) * len(_SPREAD))


def estimate_rate(state: WallState) -> Quantiles:
    """Return the rate of loss per hour, as a fraction of the wall at the baseline."""
    return _find_quantiles(RATES_PER_H, _sum_by_cell(state).sum(axis=0))


def forecast(state: WallState, loss: float) -> Quantiles:
    """Return the hours from the state's set until a loss is reached; 0: it is reached, infinite: never.

    The rate stays as it is.
    """
    hours, index = _spread_hours(loss)
    return _take_quantiles(hours, _sum_by_cell(state).ravel()[index])


@lru_cache(maxsize=8)
def _spread_hours(loss: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the hours from each cell of the grid to a loss, in order, and the cell of each."""
    # Rates are points of a logarithmic grid: each stands for the interval around it.
    step = (RATES_PER_H[2] / RATES_PER_H[1]) ** _IN_CELL
    left = np.clip(loss - LOSSES[:, None] * _SPREAD, 0.0, None)[:, None, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        hours = np.where(left == 0.0, 0.0, left / (RATES_PER_H[:, None] * step)[:, None, :])
    order = np.argsort(hours, axis=None, kind="stable")
    return hours.ravel()[order], order // (len(_SPREAD) * len(step))


def predict_loss(state: WallState, hours: float) -> Quantiles:
    """Return the loss of wall some hours after the state's set, at most the complete wall.

    The rate stays as it is.
    """
    weights = _sum_by_cell(state)
    loss, rate = np.nonzero(weights)
    rates = RATES_PER_H[rate, None] * (RATES_PER_H[2] / RATES_PER_H[1]) ** _IN_CELL
    later = (LOSSES[loss, None] * _SPREAD)[:, :, None] + hours * rates[:, None, :]
    spread = np.broadcast_to(weights[loss, rate, None, None], later.shape)
    cells = np.rint(np.clip(later, 0.0, 1.0) * FORECAST_CELLS).astype(np.intp)
    of_cells = np.asarray(np.bincount(cells.ravel(), spread.ravel()), dtype=np.float64)
    return _take_quantiles(np.arange(len(of_cells)) / FORECAST_CELLS, of_cells)


def compute_exceedance(state: WallState, loss: float) -> float:
    """Return the probability that the loss is larger than a limit."""
    of_loss = _sum_by_loss(state)
    return float(of_loss @ (LOSSES[:, None] * _SPREAD > loss).mean(axis=1))


def round_state(state: WallState) -> WallState:
    """Return the state with the digits that it has when it was stored and read."""
    first, grains = _find_grains(state)
    return replace(state, joint=_to_probabilities(grains), first=first, grains=grains)


def pack_state(state: WallState) -> bytes:
    """Return a state in some ten to 200 kB; `unpack_state` returns the same bytes' state exactly."""
    first, grains = _find_grains(state) if state.grains is None else (state.first, state.grains)
    slow = state.slow
    steps = np.diff(grains, axis=0, prepend=np.uint8(0))  # neighbors are alike: that packs better
    parts = [*slow.estimate.ravel().tolist(), *slow.explained.ravel().tolist()]
    head = np.array([state.joint.shape[2], first, first + len(grains), state.hour, *parts])
    possible = grains > 0
    content = head.tobytes() + np.packbits(possible).tobytes() + steps[possible].tobytes()
    return zlib.compress(content, 4)  # bz2 takes 5 times as long for 10 % less


def unpack_state(packed: bytes) -> WallState:
    """Return the state that `pack_state` packed; raise InvalidInputError for other bytes."""
    try:
        content = np.frombuffer(zlib.decompress(packed), dtype=np.uint8)
        n, first, last, hour, *parts = content[: 8 * HEAD].view(np.float64).tolist()
        shape = int(last - first), len(RATES_PER_H), int(n)
        possible = np.unpackbits(content[8 * HEAD :], count=math.prod(shape)).reshape(shape)
        grains = np.zeros(shape, dtype=np.uint8)
        grains[possible.view(bool)] = content[8 * HEAD - (-possible.size // 8) :]
    except (zlib.error, ValueError) as error:
        raise InvalidInputError(f"{len(packed)} bytes are no state of a wall ({error})") from error
    for index in range(1, len(grains)):
        grains[index] += possible[index] * grains[index - 1]
    slow = SlowDrift(
        estimate=np.array(parts[: -(PARTS**2)]).reshape(PARTS, -1),
        explained=np.array(parts[-(PARTS**2) :]).reshape(PARTS, PARTS),
    )
    return WallState(joint=_to_probabilities(grains), hour=hour, first=int(first), slow=slow, grains=grains)


def _find_window(of_loss: NDArray[np.generic]) -> slice:
    """Return the place of those that are not 0, with all in between."""
    possible = np.flatnonzero(of_loss)
    return slice(int(possible[0]), int(possible[-1]) + 1)


def _move_on(state: WallState, hour: float) -> NDArray[np.float32]:
    """Return the joint probability at a later hour: each rate moves its losses; then the rate may change.

    Its first loss is that of the state.
    """
    if hour < state.hour:
        raise InvalidInputError(f"a set at hour {hour:g} cannot follow hour {state.hour:g}: sort by time")
    n, hours = len(LOSSES), hour - state.hour
    per_cell_h = hours / float(LOSSES[1])
    farthest = len(state.joint) + 1 + int(min(RATES_PER_H[-1] * per_cell_h, n))
    size = min(farthest, n - state.first)
    moved = np.zeros((size, *state.joint.shape[1:]), dtype=np.float32)
    for index, rate in enumerate(RATES_PER_H.tolist()):
        cells = min(rate * per_cell_h, n - 1.0)
        whole, part = int(cells), np.float32(cells % 1.0)
        before, after = state.joint[:, index], moved[:, index]
        for shift, weight in ((whole, 1 - part), (whole + 1, part)):
            kept = min(max(size - shift, 0), len(before))
            after[shift : shift + kept] += weight * before[:kept]
            if kept < len(before):  # past the grid's end
                after[-1] += weight * before[kept:].sum(axis=0)
    return np.asarray(_compute_rate_change(hours).T.astype(np.float32) @ moved)


def _compute_rate_change(hours: float) -> FloatArray:
    """Return the probability of the next rate by the present one, some hours later."""
    part = min(hours / CHANGE_H, 1.0)
    return np.asarray((1.0 - part) * np.eye(len(RATES_PER_H)) + part * _RATE_CHANGE)


def _keep(first: int, moved: NDArray[np.float32], hour: float, slow: SlowDrift) -> WallState:
    """Return the state with these probabilities; those below `LEAST` of the largest are left out."""
    moved *= moved >= LEAST * moved.max()
    of_loss = moved.sum(axis=(1, 2))
    moved /= of_loss.sum()
    window = _find_window(of_loss)
    return WallState(joint=moved[window], hour=hour, first=first + window.start, slow=slow)


def _sum_by_loss(state: WallState) -> FloatArray:
    """Return the probability of each loss."""
    return np.asarray(_sum_by_cell(state).sum(axis=1))


@lru_cache(maxsize=1)
def _sum_by_cell(state: WallState) -> FloatArray:
    """Return the probability of each loss and rate, shape (161, 15)."""
    of_grid = np.zeros((len(LOSSES), len(RATES_PER_H)))
    of_grid[state.window] = state.joint.sum(axis=2)
    return of_grid


def _find_grains(state: WallState) -> tuple[int, NDArray[np.uint8]]:
    """Return the index of the first possible loss and the logarithms of the probabilities from there on.

    These are in `GRAINS` steps below the largest; 0: less than `LEAST`.
    """
    with np.errstate(divide="ignore"):
        steps = np.log(state.joint / state.joint.max())
    # Half a step below `LEAST` still is the last one: probabilities that were read give the same steps.
    steps *= np.float32((GRAINS - 1) / -math.log(LEAST))
    steps += np.float32(GRAINS + 0.5)
    grains = np.maximum(steps, 0.0, out=steps).astype(np.uint8)
    if np.count_nonzero(grains) > MOST_CELLS:
        from_largest = np.cumsum(np.bincount(grains.ravel(), minlength=GRAINS + 1)[:0:-1])
        grains *= grains > GRAINS - np.searchsorted(from_largest, MOST_CELLS, side="right")
    window = _find_window(grains.any(axis=(1, 2)))
    return state.first + window.start, grains[window]


def _to_probabilities(grains: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the probabilities that grains stand for, with sum 1."""
    probabilities = np.take(_OF_GRAINS, grains, mode="clip")  # takes half of the time
    probabilities /= probabilities.sum()
    return probabilities


def _find_quantiles(values: FloatArray, weights: FloatArray) -> Quantiles:
    """Return the weighted quantiles; each is one of the values, whose weight counts half below it."""
    order = np.argsort(values, axis=None, kind="stable")
    return _take_quantiles(values.ravel()[order], weights.ravel()[order])


def _take_quantiles(ordered: FloatArray, weights: FloatArray) -> Quantiles:
    """Return the weighted quantiles of values in their order."""
    possible = weights > 0.0
    values, weight = ordered[possible], weights[possible]
    middle = (np.cumsum(weight) - 0.5 * weight) / weight.sum()
    low, median, high = values[np.minimum(np.searchsorted(middle, QUANTILES), len(values) - 1)].tolist()
    return Quantiles(low=low, median=median, high=high)


_RATE_PRIOR = RATES_PER_H**TILT
_RATE_PRIOR *= (1.0 - STILL) / _RATE_PRIOR.sum()
_RATE_PRIOR[0] = STILL
_STEPS = np.eye(len(RATES_PER_H) - 1, k=1) + np.eye(len(RATES_PER_H) - 1, k=-1)
_TO_NEIGHBOR = 0.5 * NEIGHBOR * np.pad(_STEPS, (1, 0))
_KEPT_RATE = np.diag(1.0 - _TO_NEIGHBOR.sum(axis=1))
_RATE_CHANGE = (1.0 - REDRAWN) * (_KEPT_RATE + _TO_NEIGHBOR) + REDRAWN * _RATE_PRIOR
"""Probability of the next rate by the present one, `CHANGE_H` later; the rate 0 has no neighbor."""
_IN_CELL = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])
_SPREAD = 1.0 + AMBIGUITY * _to_normal((np.arange(21) + 0.5) / 21.0)
"""Points of equal probability of the ambiguity, as factors of a loss."""
_OF_GRAINS = np.exp(-math.log(LEAST) * (np.arange(GRAINS + 1) - GRAINS) / (GRAINS - 1)).astype(np.float32)
_OF_GRAINS[0] = 0.0
