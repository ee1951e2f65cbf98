"""Flag rates of foreign and own waves of a transducer, at 20, 30 and 40 dB.

    python benchmarks/flags_on_waves.py [--records N] [--seed S] [--walls one|any|alone]
        [--shape twin|cos4|gauss|sech2] [--noise-ends-hz HZ]

Records are of the twin's noise-free waves at any depth from 0 to 80 %, of two sizes of patch, or of drawn
pulses with a reflection of .38-.58 after 320-480 us; the only noise is white, or of the same rms but with
nothing above ``--noise-ends-hz``, so that it is stronger in the wave's own band. Each is the tenth shot
of a set of one wall, the others clean; with ``--walls any`` one of a file of 26 from as many walls, where of
lost samples only a reflection that is earlier than any wall's can tell; with ``--walls alone`` nothing is
beside it, and the wave's height and width are told, as by `solimon features --isw-amplitude-v --isw-fwhm-s`.
A row shows flagged and not valid shots in percent.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from analysis.waves.features import ShotFeatures, extract_from_volts
from analysis.waves.template import Template, compare_with_others, learn_template
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel

RATE_HZ, PRETRIGGER, SAMPLES = 10e6, 1_000, 13_000
TIME_S = (np.arange(SAMPLES) - PRETRIGGER) / RATE_HZ
FWHM_S = 64.7e-6
LOST_S = 50e-6
SCALE_OF_90 = 1.702
"""Scale of tanh, of the wave's height, at which its top keeps .9."""
OTHERS = {"one": 9, "any": 25, "alone": 0}
"""Clean records that a record is compared with."""
OF_A_SET = 5
"""Records next to the same others."""
FloatArray = NDArray[np.float64]
Wave = Callable[[float], FloatArray]
"""Record of a strike of height 1 whose ISW peaks at a time."""

SHAPES: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "cos4": lambda u: np.cos(np.pi * np.clip(u / 2.747, -0.5, 0.5)) ** 4,
    "gauss": lambda u: np.exp(-4.0 * math.log(2.0) * u**2),
    "sech2": lambda u: 1.0 / np.cosh(1.7627 * np.clip(u, -50.0, 50.0)) ** 2,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Strike, its hole, and the noise relative to its height."""

    random: Generator
    isw_s: float
    height: float
    wave: Wave
    silent: Wave
    tof_s: float
    noise: float
    noise_ends_hz: float = RATE_HZ / 2.0
    pink: bool = False
    time_s: FloatArray = field(default_factory=lambda: TIME_S)
    stretch: float = 1.0
    """Width of the wave over that of the paper's chain: all times below are of that one."""

    def clean(self) -> FloatArray:
        """Return a sound record."""
        return self.noisy(self.height * self.wave(self.isw_s))

    def noisy(self, volts: FloatArray) -> FloatArray:
        """Return the volts with noise."""
        return volts + self.some_noise(volts.size)

    def some_noise(self, n: int) -> FloatArray:
        """Return n samples of noise."""
        noise = self.noise * self.random.standard_normal(n)
        if self.pink:
            spectrum = np.fft.rfft(noise) / np.sqrt(np.maximum(1.0, np.arange(n // 2 + 1)))
            spectrum[0] = 0.0
            pink = np.fft.irfft(spectrum, n)
            return pink * (self.noise / pink.std())
        if self.noise_ends_hz >= RATE_HZ / 2.0:
            return noise
        spectrum = np.fft.rfft(noise)
        spectrum[np.fft.rfftfreq(n, 1.0 / RATE_HZ) > self.noise_ends_hz] = 0.0
        return np.fft.irfft(spectrum, n) / math.sqrt(2.0 * self.noise_ends_hz / RATE_HZ)


def hole(scene: Scene) -> FloatArray:
    return scene.noisy(scene.height * scene.silent(scene.isw_s))


def weak(scene: Scene) -> FloatArray:
    return scene.noisy(scene.random.uniform(0.06, 0.25) * scene.wave(scene.isw_s))


def saturated(scene: Scene) -> FloatArray:
    """Clip at .5 to .85 of the wave, noise before or after the amplifier."""
    end = scene.random.uniform(0.5, 0.85) * scene.height
    if scene.random.random() < 0.5:
        return np.minimum(scene.clean(), end)
    return scene.noisy(np.minimum(scene.height * scene.wave(scene.isw_s), end))


def cut_at_95(scene: Scene) -> FloatArray:
    """Clip at .95 of the wave; the noise comes after the amplifier."""
    return scene.noisy(np.minimum(scene.height * scene.wave(scene.isw_s), 0.95 * scene.height))


def bent_to_90(scene: Scene) -> FloatArray:
    """Limit softly, as tanh: the top falls to .9 of the wave."""
    scale = SCALE_OF_90 * scene.height
    return scene.noisy(scale * np.tanh(scene.height * scene.wave(scene.isw_s) / scale))


def second_strike(scene: Scene) -> FloatArray:
    later_s = scene.isw_s + scene.stretch * scene.random.uniform(280e-6, 450e-6)
    return scene.clean() + scene.height * scene.random.uniform(0.25, 0.5) * scene.wave(later_s)


def knock(scene: Scene) -> FloatArray:
    """Add a ringing of 2 to 12 kHz and .1 to .4 that starts within 400 us of the ISW."""
    since_s = (scene.time_s - scene.isw_s) / scene.stretch - scene.random.uniform(0.0, 400e-6)
    turns = scene.random.uniform(2e3, 12e3) * since_s + scene.random.random()
    decay = np.exp(-since_s.clip(0.0) / scene.random.uniform(0.1e-3, 0.6e-3))
    ringing = scene.random.uniform(0.1, 0.4) * decay * np.sin(2.0 * np.pi * turns)
    return scene.clean() + np.where(since_s > 0.0, ringing, 0.0)


def foreign(scene: Scene, centre_s: float, height: float) -> FloatArray:
    return height * SHAPES["gauss"](
        (scene.time_s - centre_s) / (scene.stretch * scene.random.uniform(30e-6, 100e-6))
    )


def foreign_alone(scene: Scene) -> FloatArray:
    return scene.noisy(foreign(scene, scene.isw_s, scene.random.uniform(0.1, 1.2)))


def foreign_before(scene: Scene) -> FloatArray:
    centre_s = scene.isw_s + scene.random.uniform(120e-6 * scene.stretch, scene.tof_s)
    return scene.clean() + foreign(scene, centre_s, scene.random.uniform(0.2, 0.8))


def foreign_anywhere(scene: Scene) -> FloatArray:
    return scene.clean() + foreign(
        scene, scene.stretch * scene.random.uniform(-50e-6, 1.15e-3), scene.random.uniform(0.2, 0.8)
    )


def foreign_on_the_psw(scene: Scene) -> FloatArray:
    centre_s = scene.isw_s + scene.tof_s + scene.stretch * scene.random.uniform(-40e-6, 40e-6)
    return scene.clean() + foreign(scene, centre_s, scene.random.uniform(0.2, 0.8))


def _lost(scene: Scene) -> slice:
    after_s = scene.random.uniform(-30e-6 * scene.stretch, scene.tof_s + 90e-6 * scene.stretch)
    first = round((scene.isw_s + after_s - scene.time_s[0]) * RATE_HZ)
    return slice(first, first + round(LOST_S * scene.stretch * RATE_HZ))


def lost_and_zero(scene: Scene) -> FloatArray:
    volts = scene.clean()
    volts[_lost(scene)] = 0.0
    return volts


def lost_and_held(scene: Scene) -> FloatArray:
    volts, lost = scene.clean(), _lost(scene)
    volts[lost] = volts[lost.start]
    return volts


def broken_off(scene: Scene) -> FloatArray:
    """Fill the end of the record with zeros, at the latest from its last fifth."""
    volts = scene.clean()
    volts[scene.random.integers(volts.size * 3 // 26, volts.size * 4 // 5) :] = 0.0
    return volts


def lost_and_bridged(scene: Scene) -> FloatArray:
    """Replace samples by a line between the neighbours."""
    volts, lost = scene.clean(), _lost(scene)
    volts[lost] = np.linspace(volts[lost.start], volts[lost.stop], lost.stop - lost.start)
    return volts


def lost_and_closed_up(scene: Scene) -> FloatArray:
    """Shift the rest forward; noise follows at the end."""
    volts = np.delete(scene.clean(), _lost(scene))
    return np.append(volts, scene.some_noise(scene.time_s.size - volts.size))


CASES: tuple[Callable[[Scene], FloatArray], ...] = (
    Scene.clean,
    hole,
    weak,
    saturated,
    cut_at_95,
    bent_to_90,
    second_strike,
    knock,
    foreign_alone,
    foreign_before,
    foreign_on_the_psw,
    foreign_anywhere,
    lost_and_zero,
    lost_and_held,
    broken_off,
    lost_and_bridged,
    lost_and_closed_up,
)


@cache
def twin_waves() -> list[tuple[Wave, Wave, float]]:
    """Return waves of the twin, with a hole's, and their times of flight; the mesh is coarse."""
    plate = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
    found = []
    for size_m in (25.4e-3, 50.8e-3):
        model = ShotModel(ChainParameters(), plate, CorrosionParameters(size_m=size_m), cache_folder=None)
        gone = model.shot(through_hole=True)
        silent = sampled(gone.time_s, gone.force_n - gone.preload_n)
        for depth in np.linspace(0.0, 0.8, 17):
            force = model.shot(depth_fraction=float(depth))
            pushed = force.force_n - force.preload_n
            late = force.time_s > force.time_s[pushed.argmax()] + 200e-6
            tof_s = force.time_s[late][pushed[late].argmax()] - force.time_s[pushed.argmax()]
            found.append((sampled(force.time_s, pushed), silent, float(tof_s)))
    return found


def sampled(time_s: FloatArray, pushed_n: FloatArray, at_s: FloatArray = TIME_S) -> Wave:
    peak_s, shape = time_s[pushed_n.argmax()], pushed_n / pushed_n.max()
    return lambda isw_s: np.interp(at_s - isw_s + peak_s, time_s, shape, left=0.0)


def drawn_wave(random: Generator, name: str) -> tuple[Wave, Wave, float]:
    shape, tof_s, ratio = SHAPES[name], random.uniform(320e-6, 480e-6), random.uniform(0.38, 0.58)
    width_s = random.uniform(1.05, 1.18) * FWHM_S

    def silent(isw_s: float) -> FloatArray:
        return shape((TIME_S - isw_s) / FWHM_S)

    def wave(isw_s: float) -> FloatArray:
        back = ratio * shape((TIME_S - isw_s - tof_s) / width_s)
        return silent(isw_s) + back + 0.07 * shape((TIME_S - isw_s - tof_s - 170e-6) / width_s)

    return wave, silent, tof_s


def flag_rates(
    case: Callable[[Scene], FloatArray],
    shape: str,
    snr_db: float,
    n: int,
    seed: int,
    walls: str = "one",
    noise_ends_hz: float = RATE_HZ / 2.0,
) -> tuple[float, float]:
    """Return the fractions of the shots that are flagged, and that are not valid."""
    random = np.random.default_rng([seed, round(snr_db)])

    def wall() -> tuple[Wave, Wave, float]:
        if shape != "twin":
            return drawn_wave(random, shape)
        waves = twin_waves()
        return waves[random.integers(len(waves))]

    def scene(of: tuple[Wave, Wave, float]) -> Scene:
        wave, silent, tof_s = wall() if walls == "any" else of
        return Scene(
            random=random,
            isw_s=random.uniform(35e-6, 55e-6),
            height=random.normal(1.0, 0.05),
            wave=wave,
            silent=silent,
            tof_s=tof_s,
            noise=10.0 ** (-snr_db / 20.0),
            noise_ends_hz=noise_ends_hz,
        )

    shots = []
    for _ in range(0, n, OF_A_SET):
        own = wall()
        others = [_extract_features(scene(own).clean()) for _ in range(OTHERS[walls])]
        template = Template(isw_fwhm_s=_extract_features(own[0](45e-6)).isw_fwhm_s, isw_amplitude_v=1.0)
        for _ in range(OF_A_SET):
            seen = [*others, _extract_features(case(scene(own)))]
            shots.append(compare_with_others(seen, learn_template(seen) if others else template)[-1])
    return float(np.mean([bool(shot.flags) for shot in shots])), float(
        np.mean([not shot.valid for shot in shots])
    )


def _extract_features(volts: FloatArray) -> ShotFeatures:
    return extract_from_volts(volts, RATE_HZ, PRETRIGGER)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=300, help="of each case and level of noise")
    parser.add_argument("--seed", type=int, default=902)
    parser.add_argument("--shape", choices=["twin", *SHAPES], default="twin")
    parser.add_argument("--walls", choices=[*OTHERS], default="one")
    parser.add_argument("--noise-ends-hz", type=float, default=RATE_HZ / 2.0, help="default: white")
    arguments = parser.parse_args()
    levels_db = (20.0, 30.0, 40.0)
    print(
        f"{arguments.shape}, walls {arguments.walls}, noise to {arguments.noise_ends_hz / 1e6:g} MHz, "
        "flagged / not valid in %   " + "   ".join(f"{db:.0f} dB" for db in levels_db)
    )
    for case in CASES:
        found = [
            flag_rates(
                case,
                arguments.shape,
                db,
                arguments.records,
                arguments.seed,
                arguments.walls,
                arguments.noise_ends_hz,
            )
            for db in levels_db
        ]
        template = "  ".join(f"{100 * flagged:5.1f} / {100 * bad:5.1f}" for flagged, bad in found)
        print(f"{case.__name__:22s} {template}", flush=True)


if __name__ == "__main__":
    main()
