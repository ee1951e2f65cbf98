"""Cost of feature extraction per shot, next to the direct computation at the full rate.

Records are drawn, not simulated: cos^4 pulses as wide as the paper's, white noise 40 dB below the ISW,
16 bit, 10 MS/s, 13,000 samples. Each is used once a round, so that no branch predictor learns it.

    python benchmarks/feature_extraction.py [--records N] [--rounds R] [--json]

The direct computation is what the definitions in `analysis.waves.features` say, sample by sample: quartics
by ``numpy.polyfit``, matched filter and autocorrelation by FFTs of the whole record. Both lie in
O(n log n); the ratio shows what the reduction to block means is worth. The largest difference of the
results stands next to it.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from analysis.waves.features import extract_features
from analysis.waves.record_reduction import ExtractionSettings
from hardware_drivers.measurement import Calibration, Waveform

RATE_HZ = 10e6
PRETRIGGER = 1000
SAMPLES = 13_000
FEATURES = (
    "tof_pp_s",
    "tof_mf_s",
    "tof_ac_s",
    "amplitude_ratio",
    "autocorrelation_coefficient",
    "psw_area_v_s",
)
FloatArray = NDArray[np.float64]


def records(n: int) -> list[Waveform]:
    calibration = Calibration(
        coefficients_v=np.array([1.2e-3, 5.1 / 32768, 0.0, 0.0]), resolution_bits=16, range_v=5.0
    )
    time_s = (np.arange(SAMPLES) - PRETRIGGER) / RATE_HZ
    out = []
    for seed in range(n):
        random = np.random.default_rng(seed)
        isw_s, tof_s = random.uniform(40e-6, 60e-6), random.uniform(320e-6, 420e-6)
        volts = np.zeros(SAMPLES)
        for centre_s, height in ((isw_s, 2.5), (isw_s + tof_s, 1.25), (isw_s + tof_s + 170e-6, 0.2)):
            volts += height * np.cos(np.pi * np.clip((time_s - centre_s) / 178e-6, -0.5, 0.5)) ** 4
        volts += 0.025 * random.standard_normal(SAMPLES)
        counts = np.rint(volts / calibration.coefficients_v[1]).astype(np.int16)
        out.append(
            Waveform(
                counts=counts, sample_rate_hz=RATE_HZ, pretrigger_samples=PRETRIGGER, calibration=calibration
            )
        )
    return out


def direct(waveform: Waveform) -> dict[str, float]:
    """Compute the same features directly from their definitions."""
    volts, time_s = waveform.volts(), waveform.time_s()
    # The wave of these records reaches 50 us before the trigger; what lies before is quiet.
    x = volts - np.median(volts[: PRETRIGGER - 500])
    sigma = 1.4826 * float(np.median(np.abs(np.diff(x)))) / math.sqrt(2.0)
    width = ExtractionSettings().kernel_width_s
    reach = math.ceil(width / 2 * RATE_HZ) - 1
    kernel = np.cos(np.pi * np.arange(-reach, reach + 1) / (width * RATE_HZ)) ** 4
    matched = fftconvolve(x, kernel, "same")
    isw = int(np.argmax(matched))
    window = slice(isw + 2000, isw + 9000)
    psw = window.start + int(np.argmax(matched[window]))
    isw_s, isw_v = _top(x, time_s, isw)
    psw_s, psw_v = _top(x, time_s, psw)
    tof_ac_s, coefficient = _autocorrelation(x, time_s, isw_s, psw_s, sigma)
    area = x[np.abs(time_s - psw_s) <= 90e-6].sum() / RATE_HZ
    return {
        "tof_pp_s": psw_s - isw_s,
        "tof_mf_s": _vertex(matched, psw) - _vertex(matched, isw),
        "tof_ac_s": tof_ac_s,
        "amplitude_ratio": psw_v / isw_v,
        "autocorrelation_coefficient": coefficient,
        "psw_area_v_s": float(area),
    }


def _vertex(values: FloatArray, k: int) -> float:
    before, centre, after = values[k - 1 : k + 2]
    return float(k + 0.5 * (before - after) / (before - 2.0 * centre + after)) / RATE_HZ


def _top(x: FloatArray, time_s: FloatArray, k: int) -> tuple[float, float]:
    """Return time and height of the quartic through the top above half height."""
    near = slice(k - 900, k + 900)
    smooth = np.convolve(x[near], np.full(111, 1.0 / 111), "same")
    above = smooth > 0.5 * smooth[800:1000].max()
    below = np.flatnonzero(~above)
    first, last = below[below < 900][-1] + 1, below[below > 900][0] - 1
    centre_s = time_s[near.start + 900]
    t, y = (time_s[near] - centre_s)[first : last + 1] * 1e5, x[near][first : last + 1]
    coefficients = np.polyfit(t, y, 4)
    roots = np.roots(np.polyder(coefficients))
    real = roots[np.abs(roots.imag) < 1e-9].real
    inside = real[(real > t[0]) & (real < t[-1])]
    best = inside[np.argmax(np.polyval(coefficients, inside))]
    return float(centre_s + best * 1e-5), float(np.polyval(coefficients, best))


def _autocorrelation(
    x: FloatArray, time_s: FloatArray, isw_s: float, psw_s: float, sigma: float
) -> tuple[float, float]:
    gated = np.where((time_s >= isw_s - 90e-6) & (time_s <= psw_s + 90e-6), x, 0.0)
    n_gate = int(np.count_nonzero(gated))
    spectrum = np.fft.rfft(gated, 2 * gated.size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: gated.size]
    triangle = 50.0 - np.abs(np.arange(-49, 50))
    smooth = np.convolve(correlation, triangle / triangle.sum(), "same")
    tof = round((psw_s - isw_s) * RATE_HZ)
    k = tof - 400 + int(np.argmax(smooth[tof - 400 : tof + 401]))
    return _vertex(smooth, k), float(smooth[k] / (correlation[0] - n_gate * sigma**2))


def milliseconds(call: Callable[[Waveform], object], waveforms: Sequence[Waveform], rounds: int) -> float:
    """Return the minimum of the rounds' means: the machine disturbs the others, none can be too fast."""
    best = math.inf
    for _ in range(rounds):
        start = time.perf_counter()
        for waveform in waveforms:
            call(waveform)
        best = min(best, time.perf_counter() - start)
    return 1e3 * best / len(waveforms)


def measure(n: int, rounds: int) -> dict[str, object]:
    waveforms = records(n)
    largest = dict.fromkeys(FEATURES, 0.0)
    for waveform in waveforms:
        shot, reference = extract_features(waveform), direct(waveform)
        if not shot.valid:
            raise SystemExit(f"a clean record was flagged {shot.flags}")
        for name in FEATURES:
            largest[name] = max(largest[name], abs(getattr(shot, name) - reference[name]))
    extraction = milliseconds(extract_features, waveforms, rounds)
    straight = milliseconds(direct, waveforms, rounds)
    return {
        "records": n,
        "samples": SAMPLES,
        "extraction_ms": extraction,
        "direct_ms": straight,
        "ratio": straight / extraction,
        "largest_difference": largest,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Cost of feature extraction a shot.")
    parser.add_argument("--records", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    result = measure(options.records, options.rounds)
    if options.json:
        print(json.dumps(result))
        return
    print(f"extract_features   {result['extraction_ms']:.3f} ms a shot of {SAMPLES:,} samples")
    print(f"direct, full rate  {result['direct_ms']:.3f} ms, ratio {result['ratio']:.1f}")
    for name, value in largest_lines(result):
        print(f"largest difference {name:28s} {value:.2g}")


def largest_lines(result: dict[str, object]) -> list[tuple[str, float]]:
    differences = result["largest_difference"]
    return list(differences.items()) if isinstance(differences, dict) else []


if __name__ == "__main__":
    main()
