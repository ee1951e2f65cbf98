"""Evaluate equations 14 to 17 on the test's data: features that the paper does not show, and two checks.

Equation 16 is computed again from the stored features and baseline by another method than the service's
(a linear solve instead of the whitening), equation 17 by its ratio; autocorrelation is repeated on the
averaged records with a plain sum of products.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq_service.cli.reproduce.evidence import Evidence, Series, Trace
from daq_service.cli.reproduce.item import Item, Material, Product, stack_columns
from daq_service.cli.reproduce.style import choose_colour, create_sheet, title_panels
from daq_service.settings.tree import UltrasoundSettings

GATE_S = 90e-6
"""Half the width of a pulse's window, as in the extraction of features."""
SEARCH_S = 40e-6
BLOCK_S = 1e-6
"""Records are averaged over this before the sum of products: its peak is far wider."""

_COLUMNS = (
    ("tof_ac_s", 1e6, "ToF by autocorrelation (µs)"),
    ("autocorrelation_coefficient", 1.0, "autocorrelation coefficient (1)"),
    ("psw_area_v_s", 1e6, "area under the PSW (V µs)"),
)


def draw_extra_features(material: Material) -> Product:
    """Draw the autocorrelation lag, its coefficient and the area under the PSW over the test.

    The notes contain the results of the checks of eqs 16 and 17 and of the autocorrelation. Raises
    NotAvailableError without a transducer.
    """
    test, names = material.test, material.transducers
    figure, axes = create_sheet(1, 3, height_in=3.0)
    for name in names:
        pulses = test.pulses[name]
        for axis, (column, scale, label) in zip(axes, _COLUMNS, strict=True):
            axis.plot(
                pulses.hour_h,
                scale * pulses.values[column],
                ".",
                ms=2.0,
                color=choose_colour(name, names),
                alpha=0.6,
                label=f"position {name}",
            )
            axis.set(xlabel="hour of the test (h)", ylabel=label)
    axes[0].legend(markerscale=3)
    title_panels(axes, ("travel time", "coefficient", "area"))
    table = stack_columns(test, lambda pulses: {column: pulses.values[column] for column, *_ in _COLUMNS})
    return Product(drawing=figure, tables={"": table}, notes=tuple(_list_check_results(test)))


def _list_check_results(test: Evidence) -> Sequence[str]:
    """Describe the results of the checks in sentences, one per check and position that has data."""
    sentences = []
    for name, pulses in test.pulses.items():
        error = _check_equation_16(pulses)
        if error is not None:
            sentences.append(
                f"Eq. 16 at {name}, computed again from {error[1]} stored feature vectors and the baseline: "
                f"largest difference from the stored distance {error[0]:.1e} (relative)."
            )
        lag = _check_autocorrelation(pulses, test.traces.get(name, ()))
        if lag is not None:
            sentences.append(
                f"Autocorrelation of {lag[1]} averaged records at {name}: its lag agrees within "
                f"{lag[0]:.2f} µs with the set's mean by single shots."
            )
    for name, probe in test.echoes.items():
        spread = _check_equation_17(probe, test.settings.ultrasound)
        if spread is not None:
            sentences.append(
                f"Eq. 17 at {name}: thickness over (UT - D) is the same for all {spread[1]} readings to "
                f"{spread[0]:.1e} (relative)."
            )
    return sentences


def _check_equation_16(pulses: Series) -> tuple[float, int] | None:
    """Return the largest relative difference of stored distances from eq. 16, and the number of vectors.

    None without a frozen baseline or a complete vector.
    """
    baseline = pulses.baseline
    if baseline is None or None in baseline.mean:
        return None
    vectors = np.column_stack([pulses.values[name] for name in baseline.feature_names])
    stored = pulses.values["distance_squared"]
    present = np.isfinite(vectors).all(axis=1) & np.isfinite(stored)
    if not present.any():
        return None
    off = vectors[present] - np.array(baseline.mean)
    # Features differ by ten powers of ten: scaled to unit variance the solve keeps its digits.
    sd = np.sqrt(np.diag(np.array(baseline.covariance)))
    correlation = np.array(baseline.covariance) / np.outer(sd, sd)
    scaled = off / sd
    recomputed = np.einsum("ij,ij->i", scaled, np.linalg.solve(correlation, scaled.T).T)
    return float(np.max(np.abs(recomputed / stored[present] - 1.0))), int(present.sum())


def _check_equation_17(probe: Series, ultrasound: UltrasoundSettings) -> tuple[float, int] | None:
    """Return the relative spread of ``th / (UT - D)``, constant by eq. 17, and the number of readings.

    None for fewer than two readings, or if the path between two elements is corrected: then eq. 17 was not
    used.
    """
    thickness_m, travel_time_s = probe.values["thickness_m"], probe.values["travel_time_s"]
    present = np.isfinite(thickness_m) & np.isfinite(travel_time_s)
    if ultrasound.element_separation_m or int(present.sum()) < 2:
        return None
    ratio = thickness_m[present] / (travel_time_s[present] - ultrasound.delay_s)
    return float(np.ptp(ratio) / np.abs(ratio).mean()), int(present.sum())


def _check_autocorrelation(pulses: Series, traces: Sequence[Trace]) -> tuple[float, int] | None:
    """Return the largest deviation in us of the averaged records' lag from the stored one, and their number.

    None without such records.
    """
    row_of = {int(index): row for row, index in enumerate(pulses.set_index)}
    distances = []
    for trace in traces:
        row = row_of.get(trace.set_index)
        if row is None or not np.isfinite(pulses.values["tof_ac_s"][row]):
            continue
        lag_s = _compute_lag_s(
            trace, float(pulses.values["isw_time_s"][row]), float(pulses.values["psw_time_s"][row])
        )
        distances.append(1e6 * abs(lag_s - float(pulses.values["tof_ac_s"][row])))
    return (max(distances), len(distances)) if distances else None


def _compute_lag_s(trace: Trace, isw_s: float, psw_s: float) -> float:
    """Compute the lag in s of the highest autocorrelation within `SEARCH_S` of the distance of both peaks.

    ``isw_s`` and ``psw_s`` are the times of the peaks. The record is averaged over `BLOCK_S` first; a
    parabola through three points refines the lag.
    """
    step_s = float(trace.time_s[1] - trace.time_s[0])
    every = max(1, round(BLOCK_S / step_s))
    n = trace.volts.size // every
    volts = trace.volts[: n * every].reshape(n, every).mean(axis=1)
    time_s = trace.time_s[: n * every].reshape(n, every).mean(axis=1)
    quiet = time_s < isw_s - GATE_S
    volts = volts - (np.median(volts[quiet]) if quiet.any() else 0.0)
    gate = volts[(time_s >= isw_s - GATE_S) & (time_s <= psw_s + GATE_S)]
    products = np.correlate(gate, gate, mode="full")[gate.size - 1 :]
    block_s = every * step_s
    low, high = (round((psw_s - isw_s + side * SEARCH_S) / block_s) for side in (-1.0, 1.0))
    peak = low + int(np.argmax(products[low : high + 1]))
    before, at, after = products[peak - 1 : peak + 2]
    return float((peak + 0.5 * (before - after) / (before - 2.0 * at + after)) * block_s)


EQUATIONS = Item(name="eqs14-17", make=draw_extra_features, needs_test=True)
