"""Probability of detection (POD) of a wall loss, after MIL-HDBK-1823A and ASTM E3023.

Two models. The *loss at detection* has one value per sensor, which is lognormal over sensors (Berens 1989,
ASM Handbook 17); a sensor without a detection is censored at the largest loss that it reached. The *signal
response* (a-hat against a) uses every look at every sensor, with a random effect of the sensor. In both the
90/95 bound a90/95 is an upper 95 % confidence bound of the loss that is detected with a probability of 90 %.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.special import log_ndtr, ndtri
from scipy.stats import binomtest, f, nct

from analysis.errors import InvalidInputError, NotEnoughDataError
from analysis.waves.record_reduction import FloatArray

FEWEST_SENSORS = 6
"""Fewest sensors of a study: the coverage of the bounds is simulated from here on."""
FEWEST_DETECTIONS = 3
"""Of the sensors, these many need a detection."""
CONFIDENCE = 0.95
_RATIO_LEVEL = 0.1
"""The ratio of variances is taken at its upper 90 % limit: so the bounds cover (simulated on other seeds)."""
PROBABILITIES = np.round([0.01, 0.02, *np.linspace(0.05, 0.95, 19), 0.98, 0.99], 2)
"""Probabilities of detection of the curves; they include 0.5 and 0.9."""
_A50, _A90 = np.searchsorted(PROBABILITIES, (0.5, 0.9)).tolist()
_WIDE = 12.0
"""Bounds of the logarithm of a scale or of a ratio of variances, relative to its natural unit."""
_FARTHEST = 1e4
"""A bound beyond so many standard deviations is infinite: the data do not limit it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DetectionCurve:
    """Loss that is detected with each of `PROBABILITIES`, and its upper 95 % bound.

    Attributes
    ----------
    n_sensors, n_detected
        Sensors of the study, and those with a detection (of a signal response: above the threshold).
    loss_m, bound_m
        Shape (23,), rising; a bound is infinite where the data do not limit it.
    """

    n_sensors: int
    n_detected: int
    loss_m: FloatArray
    bound_m: FloatArray

    @property
    def a50_m(self) -> float:
        """Return the loss that half of the sensors detect."""
        return float(self.loss_m[_A50])

    @property
    def a90_m(self) -> float:
        """Return the loss that 90 % of the sensors detect."""
        return float(self.loss_m[_A90])

    @property
    def a90_95_m(self) -> float:
        """Return the upper 95 % confidence bound of `a90_m`."""
        return float(self.bound_m[_A90])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalResponse(DetectionCurve):
    """Detection curve of ``ln signal = intercept + slope ln loss + sensor + look``.

    Attributes
    ----------
    sd_sensors, sd_looks
        Standard deviations of ln signal between sensors, and between looks at one sensor.
    """

    intercept: float
    slope: float
    sd_sensors: float
    sd_looks: float


def compute_tolerance_factor(
    n: float, probability: float, confidence: float = CONFIDENCE, dof: float | None = None
) -> float:
    """Compute the one-sided tolerance factor k of a normal sample of n values.

    ``mean + k sd`` is above the quantile of this probability with this confidence, exactly:
    ``k = t(confidence; dof, z sqrt(n)) / sqrt(n)``, t the quantile of the noncentral t distribution, z that
    of the normal one (Owen 1968, Technometrics 10, 445; ISO 16269-6). ``dof`` is n - 1 unless given.
    """
    quantile = nct.ppf(confidence, n - 1.0 if dof is None else dof, ndtri(probability) * math.sqrt(n))
    return float(quantile) / math.sqrt(n)


def compute_rate_interval(events: int, trials: int) -> tuple[float, float]:
    """Compute the exact 95 % interval of a rate (Clopper and Pearson 1934); trials of at least one."""
    low, high = binomtest(events, trials).proportion_ci(CONFIDENCE, method="exact")
    return float(low), float(high)


def fit_detection_losses(
    sensors: Sequence[Hashable], loss_m: ArrayLike, detected: ArrayLike
) -> DetectionCurve:
    """Fit the lognormal distribution of the loss at detection, one value per sensor.

    The parameters are those of maximum likelihood, the scale times ``sqrt(m / (m - 1))`` for m detections:
    without censored sensors mean and standard deviation of ln loss. The bound is that of `bound_quantile`.

    Parameters
    ----------
    sensors
        Names, one for each value: looks at one sensor are not independent.
    loss_m
        Loss at the first detection, or the largest loss without one, above 0; shape (n,).
    detected
        Shape (n,).

    Raises
    ------
    InvalidInputError
        Shapes differ, a sensor has more than one value, a loss is not above 0, or all are equal.
    NotEnoughDataError
        Fewer than `FEWEST_SENSORS` sensors or `FEWEST_DETECTIONS` detections.
    """
    loss, found = np.asarray(loss_m, dtype=np.float64), np.asarray(detected, dtype=bool)
    _check(sensors, loss, found)
    repeated, count = Counter(sensors).most_common(1)[0]
    if count > 1:
        raise InvalidInputError(
            f"sensor {repeated!r} has {count} values, which are not independent: give each sensor one value, "
            "its loss at the first detection, or the largest one without"
        )
    n_found = int(found.sum())
    if n_found < FEWEST_DETECTIONS:
        raise NotEnoughDataError(
            f"{n_found} sensors with a detection; a POD needs {FEWEST_DETECTIONS}: test to larger losses"
        )
    y = np.log(loss)
    if np.ptp(y[found]) == 0.0:
        raise InvalidInputError(f"all losses at detection are {loss[found][0]:g} m: give measured values")
    mean, sd, _ = _fit_censored(y, found)
    sd *= math.sqrt(n_found / (n_found - 1.0))
    return DetectionCurve(
        n_sensors=y.size,
        n_detected=n_found,
        loss_m=np.exp(mean + sd * ndtri(PROBABILITIES)),
        bound_m=np.exp([bound_quantile(y, found, probability) for probability in PROBABILITIES]),
    )


def bound_quantile(values: ArrayLike, observed: ArrayLike, probability: float) -> float:
    """Return the upper 95 % bound of a quantile of a normal sample that is censored on the right.

    A complete sample has the exact bound. Otherwise the bound is the quantile at which the signed root of the
    profile likelihood ratio, ``sqrt(2 (l_max - l(quantile)))`` (Meeker, Hahn and Escobar 2017, Statistical
    Intervals), reaches its value at the exact bound of a complete sample of as many values
    as were observed. So it is calibrated to small samples, and exact without censoring.

    Parameters
    ----------
    values, observed
        Shape (n,); a value that is not observed is only known to be larger. At least two observed ones that
        differ.
    """
    y, is_seen = np.asarray(values, dtype=np.float64), np.asarray(observed, dtype=bool)
    n, z = int(is_seen.sum()), float(ndtri(probability))
    origin, unit = float(y[is_seen].mean()), float(y[is_seen].std())
    exact = compute_tolerance_factor(n, probability) * math.sqrt(n / (n - 1.0))
    if is_seen.all():
        return origin + unit * exact
    # Any complete sample of n values with mean 0 and standard deviation 1 has the same likelihood.
    complete, scaled = np.linspace(-1.0, 1.0, n), (y - origin) / unit
    limit = -0.5 * n - _profile_likelihood(exact, z, complete / complete.std(), complete[:0])
    mean, sd, largest = _fit_censored(scaled, is_seen)

    def is_above(quantile: float) -> float:
        """Return a number that rises with the quantile and is 0 at the bound."""
        return largest - _profile_likelihood(quantile, z, scaled[is_seen], scaled[~is_seen]) - limit

    return origin + unit * _find_zero(is_above, mean + z * sd, sd)


def fit_signal_response(
    sensors: Sequence[Hashable], loss_m: ArrayLike, signal: ArrayLike, threshold: float
) -> SignalResponse:
    """Fit the signal over the loss with a random effect of each sensor, and the POD of one look.

    ``ln signal = b0 + b1 ln loss + u_sensor + e`` with normal u and e, by restricted maximum likelihood
    (Laird and Ware 1982, Biometrics 38, 963). A look detects if its signal is at least the threshold:
    ``POD(loss) = Phi((b0 + b1 ln loss - ln threshold) / s)`` with ``s^2 = sd_sensors^2 + sd_looks^2``, so
    the scatter between sensors is part of it (MIL-HDBK-1823A, appendix G). The bound is a tolerance bound
    (Mee and Owen 1983, Journal of the American Statistical Association 78, 901): with the effective number
    of values ``s^2 / var(b0 + b1 ln loss)`` and Satterthwaite's degrees of freedom of s^2, both at an upper
    limit of the ratio of the two variances.

    Parameters
    ----------
    sensors
        Name of the sensor of each look.
    loss_m, signal
        Above 0; shape (n,).

    Raises
    ------
    InvalidInputError
        Shapes differ, a value is not above 0, or the signal does not rise with the loss.
    NotEnoughDataError
        Fewer than `FEWEST_SENSORS` sensors, or not more looks than sensors.
    """
    loss, response = np.asarray(loss_m, dtype=np.float64), np.asarray(signal, dtype=np.float64)
    _check(sensors, loss, response)
    if not (threshold > 0.0 and np.all(response > 0.0)):
        raise InvalidInputError(f"threshold {threshold:g} and each signal must be above 0: use a ratio")
    _, of_sensor, counts = np.unique(np.asarray(sensors), return_inverse=True, return_counts=True)
    k, n = counts.size, loss.size
    if n < k + 2 or np.ptp(loss) == 0.0:
        raise NotEnoughDataError(f"{n} looks at {k} sensors; a slope needs more losses than one per sensor")
    origin = float(np.log(loss).mean())
    columns = np.stack([np.ones(n), np.log(loss) - origin, np.log(response / threshold)], axis=1)
    sums = np.zeros((k, 3))
    np.add.at(sums, of_sensor, columns)
    looks = _Looks(products=columns.T @ columns, sums=sums, counts=counts.astype(np.int64))
    ratio = math.exp(minimize_scalar(looks.deviance, bounds=(-_WIDE, _WIDE), method="bounded").x)
    (b0, b1), rest = looks.solve(ratio)
    if b1 <= 0.0:
        raise InvalidInputError(f"the signal does not rise with the loss: slope {b1:.3g} of the logarithms")
    variance = rest / (n - 2)
    sd = math.sqrt(variance * (1.0 + ratio))
    usual, dof_looks = k / float(np.sum(1.0 / counts)), max(n - k - 1, 1)
    largest = ((1.0 + usual * ratio) / float(f.ppf(_RATIO_LEVEL, k - 1, dof_looks)) - 1.0) / usual
    dof = (1.0 + largest) ** 2 / (
        (largest + 1.0 / usual) ** 2 / (k - 1) + (1.0 - 1.0 / usual) ** 2 / dof_looks
    )
    spread = np.linalg.inv(looks.moments(largest)[:2, :2]) / (1.0 + largest)

    def excess(at: float, probability: float) -> float:
        """Return the margin of the mean signal over the tolerance bound, in standard deviations."""
        row = np.array([1.0, at])
        factor = compute_tolerance_factor(1.0 / float(row @ spread @ row), probability, dof=dof)
        return float(b0 + b1 * at) / sd - factor

    centers = (sd * ndtri(PROBABILITIES) - b0) / b1
    bounds = [
        _find_zero(excess, at, sd / b1, probability)
        for at, probability in zip(centers, PROBABILITIES, strict=True)
    ]
    return SignalResponse(
        n_sensors=k,
        n_detected=np.unique(of_sensor[columns[:, 2] >= 0.0]).size,
        intercept=float(b0 - b1 * origin) + math.log(threshold),
        slope=float(b1),
        sd_sensors=math.sqrt(variance * ratio),
        sd_looks=math.sqrt(variance),
        loss_m=np.exp(origin + centers),
        bound_m=np.exp(origin + np.array(bounds)),
    )


def _find_zero(rising: Callable[..., float], start: float, step: float, *arguments: float) -> float:
    """Return where a function that rises is 0, searched upwards from the start; infinite if nowhere."""
    low = high = start
    while rising(high, *arguments) < 0.0:
        low, high, step = high, high + step, 2.0 * step
        if high - start > _FARTHEST:
            return math.inf
    return float(brentq(rising, low, high, args=arguments)) if high > low else start


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Looks:
    """Sums of [1, x, y] over the looks at each sensor (shape (k, 3)), and of their products (3, 3)."""

    products: FloatArray
    sums: FloatArray
    counts: NDArray[np.int64]

    def moments(self, ratio: float) -> FloatArray:
        """Return [1, x, y]' V^-1 [1, x, y], V = I + ratio for looks at the same sensor; shape (3, 3)."""
        weights = ratio / (1.0 + ratio * self.counts)
        return np.asarray(self.products - (self.sums.T * weights) @ self.sums)

    def solve(self, ratio: float) -> tuple[FloatArray, float]:
        """Return intercept and slope of least squares with V, and the sum of squares of the residuals."""
        m = self.moments(ratio)
        line = np.asarray(np.linalg.solve(m[:2, :2], m[:2, 2]), dtype=np.float64)
        return line, max(float(m[2, 2] - m[:2, 2] @ line), float(np.finfo(np.float64).tiny))

    def deviance(self, log_ratio: float) -> float:
        """Return -2 times the restricted log likelihood, but for a constant."""
        ratio = math.exp(log_ratio)
        log_det = np.log1p(ratio * self.counts).sum() + np.linalg.slogdet(self.moments(ratio)[:2, :2])[1]
        return float((self.counts.sum() - 2) * math.log(self.solve(ratio)[1]) + log_det)


def _check(sensors: Sequence[Hashable], loss_m: FloatArray, values: np.ndarray) -> None:
    """Raise the errors that both fits share: shapes, losses, and the number of sensors."""
    if not (loss_m.ndim == 1 and loss_m.shape == values.shape == (len(sensors),)):
        shapes = f"{len(sensors)}, {loss_m.shape}, {values.shape}"
        raise InvalidInputError(f"sensors, losses and results need one shape (n,), got {shapes}")
    if not np.all((loss_m > 0.0) & np.isfinite(loss_m)):
        raise InvalidInputError("each loss must be finite and above 0: alarms at a sound wall are false")
    if (n_sensors := len(set(sensors))) < FEWEST_SENSORS:
        raise NotEnoughDataError(
            f"{n_sensors} sensors with a wall loss; a POD needs at least {FEWEST_SENSORS}: test more sensors"
        )


def _log_likelihood(shift: float, log_scale: float, seen: FloatArray, censored: FloatArray) -> float:
    """Return the log likelihood of a censored normal sample with residuals ``y / sd + shift``."""
    scale = math.exp(log_scale)
    residuals = scale * seen + shift
    return float(
        seen.size * log_scale - 0.5 * residuals @ residuals + log_ndtr(-(scale * censored + shift)).sum()
    )


def _fit_censored(y: FloatArray, is_seen: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return mean, standard deviation and log likelihood (of scaled values) of the likeliest normal sample.

    In shift and scale the log likelihood has one maximum (Olsen 1978, Econometrica 46, 1211).
    """
    origin, unit = float(y[is_seen].mean()), float(y[is_seen].std())
    parts = (y[is_seen] - origin) / unit, (y[~is_seen] - origin) / unit
    found = minimize(lambda at: -_log_likelihood(at[0], at[1], *parts), np.zeros(2), method="BFGS")
    sd = unit / math.exp(found.x[1])
    return origin - float(found.x[0]) * sd, sd, -float(found.fun)


def _profile_likelihood(quantile: float, z: float, seen: FloatArray, censored: FloatArray) -> float:
    """Return the largest log likelihood of a normal sample whose quantile at the normal score z is given."""

    def loss(log_scale: float) -> float:
        """Return minus the log likelihood at 1 / sd; the residual at the quantile is z."""
        return -_log_likelihood(z - math.exp(log_scale) * quantile, log_scale, seen, censored)

    found = minimize_scalar(loss, bounds=(-_WIDE, _WIDE), method="bounded", options={"xatol": 1e-7})
    return -float(found.fun)
