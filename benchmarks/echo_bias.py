"""Bias of the ultrasonic reading of the twin's walls, and the coverage of its interval.

Run ``python benchmarks/echo_bias.py [--walls N]``. Every wall is drawn again, thinned, recorded with the
default noise and read by correlation with the sound wall's echo and equation 17. Prints smooth walls, the
V-shaped path, rough walls, and the paper's own experiment at its end.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.ultrasound.thickness import (
    EchoReference,
    TravelTime,
    compute_thickness,
    find_reference_echo,
    thickness_interval,
    travel_time,
)
from hardware_drivers.measurement import ShotKey, Waveform
from simulator.echo.far_wall import draw_gaussian_field, draw_rough_spot
from simulator.echo.pulse import build_echo_calibration, simulate_bubbles, simulate_echo
from simulator.echo.records import ProbedWall, build_wall, draw_disturbance, simulate_record
from simulator.electronics.transduction import quantise_volts
from simulator.parameters.echo import EchoParameters
from simulator.parameters.experiment import TwinParameters
from simulator.specimen import build_specimen

PRISTINE_M = 6.35e-3
CORE_M = 3.8e-3
PATCH_M = 25.4e-3
DEFAULT = EchoParameters()
STRAIGHT = replace(DEFAULT, element_separation_m=0.0)
SMOOTH = replace(STRAIGHT, roughness_fraction=0.0)
THICKNESSES_MM = (6.35, 6.0, 5.0, 4.2, 3.8, 3.0, 2.0, 1.5)
ROUGH_CASES = (
    (0.05, 2.4e-3),
    (0.1, 2.4e-3),
    (0.2, 1.2e-3),
    (0.2, 2.4e-3),
    (0.2, 4.8e-3),
)
ROUGH_THICKNESSES_MM = (5.7, 5.0, 4.2, 3.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Reading of one wall; thicknesses in metres, NaN where there is no result."""

    true_m: float
    roughness_rms_m: float
    found: TravelTime
    read_m: float
    low_m: float
    high_m: float

    @property
    def error_m(self) -> float:
        """Return the error, positive if too thick."""
        return self.read_m - self.true_m

    @property
    def held(self) -> bool:
        """Return whether the interval holds the mean thickness under the beam."""
        return self.low_m <= self.true_m <= self.high_m


def waveform_of(volts: NDArray[np.float64], echo: EchoParameters) -> Waveform:
    calibration = build_echo_calibration(echo)
    return Waveform(
        counts=quantise_volts(volts, calibration),
        sample_rate_hz=echo.sample_rate_hz,
        pretrigger_samples=0,
        calibration=calibration,
    )


def record_wall(wall: ProbedWall, echo: EchoParameters, seed: int) -> Waveform:
    """Return the averaged record of a wall with noise and bubbles."""
    key = ShotKey(position="A", set_index=seed, shot_index=0)
    found, _ = draw_disturbance(echo, seed=seed, key=key)
    volts, _ = simulate_record(
        wall, echo, build_echo_calibration(echo), found, seed=seed, key=key, noisy=True
    )
    return waveform_of(volts, echo)


def sound_wall(echo: EchoParameters) -> EchoReference:
    """Return the reference without noise, so that one draw of it does not shift every reading."""
    return find_reference_echo(
        waveform_of(simulate_echo(PRISTINE_M, echo), echo),
        delay_s=echo.delay_s,
        initial_thickness_m=PRISTINE_M,
    )


def readings(
    echo: EchoParameters,
    thickness_m: float,
    walls: int,
    *,
    known_separation_m: float = 0.0,
    first_seed: int = 0,
) -> Iterator[Reading]:
    """Return readings of walls of one mean thickness, each rough in its own way."""
    reference = sound_wall(echo)
    for seed in range(first_seed, first_seed + walls):
        spot = draw_rough_spot(echo, seed=seed, position="A")
        wall = build_wall(PRISTINE_M, 1.0 - thickness_m / PRISTINE_M, spot, 0.0)
        found = travel_time(record_wall(wall, echo, seed), reference)
        read = compute_thickness(
            found.travel_time_s, reference.travel_time_s, echo.delay_s, PRISTINE_M, known_separation_m
        )
        interval = thickness_interval(found, reference, PRISTINE_M, known_separation_m)
        yield Reading(
            true_m=wall.thickness_m,
            roughness_rms_m=0.0 if wall.facets is None else wall.facets.rms_m,
            found=found,
            read_m=read.thickness_m,
            low_m=interval.low_m,
            high_m=interval.high_m,
        )


def pick_bound_m(echo: EchoParameters, thickness_m: float) -> float:
    """Return the Cramer-Rao bound of the thickness: a pulse of known shape in the mean's white noise."""
    alone = replace(echo, multiple_ratio=0.0, front_wall_v=0.0)
    slope = np.gradient(simulate_echo(thickness_m, alone)) * echo.sample_rate_hz
    noise_v = echo.noise_rms_v / math.sqrt(echo.averages)
    return 0.5 * echo.velocity_m_per_s * noise_v / math.sqrt(float(slope @ slope))


def print_smooth(walls: int) -> None:
    print("\nSmooth walls, straight path: error of the reading in um")
    print("| thickness | mean | SD | bound | interval holds | read |\n|---|---|---|---|---|---|")
    for mm in THICKNESSES_MM:
        found = list(readings(SMOOTH, mm * 1e-3, walls))
        error_um = 1e6 * np.array([reading.error_m for reading in found])
        print(
            f"| {mm:g} mm | {error_um.mean():+.2f} | {error_um.std(ddof=1):.2f} | "
            f"{1e6 * pick_bound_m(SMOOTH, mm * 1e-3):.2f} | {np.mean([r.held for r in found]):.0%} | "
            f"{np.mean([r.found.quality == 'good' for r in found]):.0%} |"
        )


def print_path() -> None:
    print(
        f"\nEquation 17 on a V of s = {1e3 * DEFAULT.element_separation_m:g} mm, smooth wall, without noise"
    )
    print("| thickness | read | read with s known |\n|---|---|---|")
    echo = replace(DEFAULT, roughness_fraction=0.0)
    reference = sound_wall(echo)
    for mm in THICKNESSES_MM:
        found = travel_time(waveform_of(simulate_echo(mm * 1e-3, echo), echo), reference)
        times = (found.travel_time_s, reference.travel_time_s, echo.delay_s, PRISTINE_M)
        plain, known = compute_thickness(*times), compute_thickness(*times, echo.element_separation_m)
        print(f"| {mm:g} mm | {1e3 * plain.thickness_m:.3f} mm | {1e3 * known.thickness_m:.3f} mm |")


def print_rough(walls: int) -> None:
    print(f"\nRough walls, straight path, {walls} a row: error of the reading in mm")
    print(
        "| SD of ln loss | correlation | thickness | RMS | mean | SD | good, suspect, none | interval holds |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for fraction, length_m in ROUGH_CASES:
        echo = replace(STRAIGHT, roughness_fraction=fraction, correlation_length_m=length_m)
        for mm in ROUGH_THICKNESSES_MM:
            print_row(
                f"| {fraction:g} | {1e3 * length_m:g} mm | {mm:g} mm ", list(readings(echo, mm * 1e-3, walls))
            )


def print_row(start: str, found: list[Reading]) -> None:
    read = [reading for reading in found if reading.found.quality != "bad"]
    error_mm = 1e3 * np.array([reading.error_m for reading in read])
    qualities = [np.mean([r.found.quality == q for r in found]) for q in ("good", "suspect", "bad")]
    print(
        f"{start}| {1e3 * np.mean([r.roughness_rms_m for r in found]):.2f} mm | {error_mm.mean():+.2f} | "
        f"{error_mm.std(ddof=1):.2f} | {', '.join(f'{share:.0%}' for share in qualities)} | "
        f"{np.mean([r.held for r in read]):.0%} |",
        flush=True,
    )


def print_paper(walls: int) -> None:
    print(f"\nThe paper's probe at the end of its test: {1e3 * CORE_M:g} mm under the beam, {walls} walls")
    for known_m in (0.0, DEFAULT.element_separation_m):
        found = list(readings(DEFAULT, CORE_M, walls, known_separation_m=known_m))
        held = np.mean([r.held for r in found if r.found.quality != "bad"])
        error_mm = 1e3 * np.array([r.error_m for r in found if r.found.quality != "bad"])
        low, middle, high = np.quantile(error_mm, (0.05, 0.5, 0.95))
        print(
            f"  {'s known' if known_m else 'equation 17 as it stands'}: error {error_mm.mean():+.2f} mm "
            f"(median {middle:+.2f}, 90 % of the walls within {low:+.2f} and {high:+.2f}), SD "
            f"{error_mm.std(ddof=1):.2f} mm; +0.4 mm or more in {np.mean(error_mm >= 0.4):.0%}; interval "
            f"holds {held:.0%}"
        )
    trend_m = PRISTINE_M - (PRISTINE_M - 4.2e-3) * 350.0 / 300.0
    print(f"  4.2 mm at 300 h on a straight line from 6.35 mm are {1e3 * trend_m:.2f} mm at 350 h")
    across_m = np.linspace(0.0, PATCH_M, 100)
    ranges = []
    for seed in range(40):
        field = draw_gaussian_field(
            across_m, across_m, DEFAULT.correlation_length_m, np.random.default_rng(seed)
        )
        ranges.append(np.ptp(field))
    span = math.log((PRISTINE_M - 2e-3) / (PRISTINE_M - 5e-3))
    print(
        f"  a patch of {1e3 * PATCH_M:g} mm spans {np.mean(ranges):.1f} SD of ln loss; 2 to 5 mm, as in the "
        f"core, are a span of {span:.2f}: an SD of {span / np.mean(ranges):.2f}"
    )


def print_demo() -> None:
    """Print the default test, one wall of one seed: what `solimon demo` shows at position A."""
    twin = TwinParameters()
    specimen = build_specimen(twin, transducers={}, probed_thickness_m={"A": PRISTINE_M})
    key = ShotKey(position="A", set_index=0, shot_index=0)
    reference = find_reference_echo(
        specimen.echo(key, 0.5).waveform, delay_s=twin.echo.delay_s, initial_thickness_m=PRISTINE_M
    )
    print(f"\nThe default experiment's own wall, seed {twin.seed}")
    for hour_h in (100.0, 200.0, 300.0, 350.0):
        echo = specimen.echo(ShotKey(position="A", set_index=round(hour_h), shot_index=0), hour_h)
        found = travel_time(echo.waveform, reference)
        read = compute_thickness(found.travel_time_s, reference.travel_time_s, twin.echo.delay_s, PRISTINE_M)
        interval = thickness_interval(found, reference, PRISTINE_M)
        print(
            f"  hour {hour_h:g}: wall {1e3 * echo.truth['thickness_m']:.2f} mm (rms "
            f"{1e3 * echo.truth['roughness_rms_m']:.2f}), read {1e3 * read.thickness_m:.2f} mm in "
            f"{1e3 * interval.low_m:.2f} to {1e3 * interval.high_m:.2f}, {found.quality}"
        )


def print_bubbles() -> None:
    records = simulate_bubbles(CORE_M, DEFAULT, np.random.default_rng(0), 400)
    echo_v = float(np.abs(simulate_echo(CORE_M, SMOOTH)).max())
    print(
        f"\nBubbles: RMS {records.std() / echo_v:.1e}, highest crest {np.abs(records).max() / echo_v:.1e} of "
        f"a smooth wall's echo; {DEFAULT.bubbles_per_beam:g} of {1e3 * DEFAULT.bubble_radius_m:g} mm a record"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walls", type=int, default=200, help="walls of each row")
    walls = parser.parse_args().walls
    print_smooth(walls)
    print_path()
    print_rough(walls)
    print_paper(walls)
    print_demo()
    print_bubbles()


if __name__ == "__main__":
    main()
