"""What a transducer's chain says about its record: width of its wave, search windows, limits.

Chains of the same number of spheres are similar: with gravity and dashpots left out, every time goes with
``(m^2 / (A^2 v))^(1/5)`` and every force with ``(m^3 A^2 v^6)^(1/5)``, m the mass of a sphere, A the Hertz
stiffness between two and v the striker's speed. So the paper's chain, for which the limits were found, gives
those of all others. Each sphere below the sensor, passed twice, adds to the time of flight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from analysis.waves.record_reduction import USUAL_FWHM_S, ExtractionSettings, minimum_after_isw_s

FREE_FALL_M_PER_S2 = 9.81
GREATEST_INELASTICITY, LEAST_RATIO, LEAST_TOF_WIDTHS, GREATEST_PRECOMPRESSION = 0.7, 0.2, 2.5, 2.0
"""Beyond the first the plate swallows the wave. A reflection of the second is twice the weakest that counts.
The two waves, each of which reaches 1.1 widths beyond its middle, must be the third of widths apart. A chain
pressed by more than the last, times the wave's force, has no solitary waves."""
SPHERE_SENSOR_WIDTH = 1.14
"""Width of the wave at a sphere as the sensor over that at a disk, whose contacts are stiffer (twin)."""
DASHPOT_WIDENS = 1.1
"""Per dashpot times wave time over mass: spheres of 6 mm widen their wave by .02 to .16 (twin)."""
TOF_WIDTHS, TOF_WIDTHS_PER_SPHERE = 4.9, 1.1
"""Time of flight over wave width at a rigid wall, four spheres below the sensor; each one more, passed twice,
adds 2.36 (m^2 / (A^2 v))^(1/5) (Nesterenko's theory and the twin)."""
PAPER_ISW_N = 151.0
CLOSING_WIDTHS = 0.4
"""The reflected wave opens a pressed chain at its top. The precompression closes it after that many widths or
more, over precompression over ISW (twin), and the next wave comes down to the sensor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainDescription:
    """What the width and the times of a chain's waves depend on; by default the paper's.

    Bodies that differ from the others are left out: the spheres that most of the chain consists of count.
    """

    radius_m: float = 9.525e-3
    mass_kg: float = 28.2e-3
    youngs_modulus_pa: float = 200e9
    poisson_ratio: float = 0.3
    spheres_above: int = 4
    spheres_below: int = 4
    sensor_is_disk: bool = True
    drop_height_m: float = 5e-3
    damping_n_s_per_m: float = 4.5
    precompression_n: float = 0.0

    @property
    def stiffness_n_per_m15(self) -> float:
        """Return the Hertz stiffness A between two spheres."""
        plane_pa = self.youngs_modulus_pa / (1.0 - self.poisson_ratio**2)
        return plane_pa * math.sqrt(2.0 * self.radius_m) / 3.0

    @property
    def speed_m_per_s(self) -> float:
        """Return the speed of the striker."""
        return math.sqrt(2.0 * FREE_FALL_M_PER_S2 * self.drop_height_m)

    @property
    def wave_time_s(self) -> float:
        """Return a time in proportion to the incident wave's width."""
        similar_s = math.pow(self.mass_kg**2 / (self.stiffness_n_per_m15**2 * self.speed_m_per_s), 0.2)
        sensor = 1.0 if self.sensor_is_disk else SPHERE_SENSOR_WIDTH
        return sensor * similar_s * (1.0 + DASHPOT_WIDENS * self.damping_n_s_per_m * similar_s / self.mass_kg)

    @property
    def wave_force_n(self) -> float:
        """Return a force in proportion to the incident wave's height."""
        return math.pow(self.mass_kg**3 * self.stiffness_n_per_m15**2 * self.speed_m_per_s**6, 0.2)

    @property
    def precompression_ratio(self) -> float:
        """Return the precompression over the incident wave's height."""
        return self.precompression_n / (PAPER_ISW_N * self.wave_force_n / PAPER.wave_force_n)

    @property
    def tof_widths(self) -> float:
        """Return the shortest time of flight, from a rigid wall, over the incident wave's width."""
        return TOF_WIDTHS + TOF_WIDTHS_PER_SPHERE * (self.spheres_below - PAPER.spheres_below)


PAPER = ChainDescription()


def settings_of_chain(chain: ChainDescription, **given: float) -> ExtractionSettings:
    """Derive the extraction settings of a chain; ``given`` fields (`ExtractionSettings`) have priority.

    Those of the paper's chain are the defaults. Raise InvalidInputError for values that contradict.
    """
    width_s = given.pop("isw_fwhm_s", USUAL_FWHM_S * (chain.wave_time_s / PAPER.wave_time_s))
    usual = ExtractionSettings.for_width(width_s)
    later_s = (chain.tof_widths - PAPER.tof_widths) * width_s
    pressed = chain.precompression_ratio
    derived = {
        "psw_earliest_s": usual.psw_earliest_s * (chain.tof_widths / PAPER.tof_widths),
        "psw_latest_s": usual.psw_latest_s + later_s,
        "second_reflection_earliest_s": usual.second_reflection_earliest_s + later_s,
        "second_reflection_latest_s": usual.second_reflection_latest_s + later_s,
        "second_reflection_latest_tof_s": usual.second_reflection_latest_tof_s + later_s,
        "deepest_pull_fraction": usual.deepest_pull_fraction + pressed,
    }
    if pressed:
        widths = TOF_WIDTHS_PER_SPHERE * (chain.spheres_above - 1) + CLOSING_WIDTHS / pressed
        derived["second_strike_latest_s"] = min(usual.second_strike_latest_s, widths * width_s)
        # It stays in contact with the plate, whose own waves would look like a second strike's reflection.
        derived["second_reflection_latest_s"] = usual.second_reflection_earliest_s
    return replace(usual, **(derived | given))


def find_obstacles(
    chain: ChainDescription,
    settings: ExtractionSettings,
    *,
    inelasticity: float,
    amplitude_ratio: float,
    after_trigger_s: float = math.inf,
) -> list[str]:
    """Find why a transducer's waves cannot be assessed, each with number, limit and remedy; empty: they can.

    Parameters
    ----------
    inelasticity, amplitude_ratio
        Zener's lambda (eq. 9 of the paper) and the expected ratio of PSW to ISW on the sound plate.
    after_trigger_s
        Length of the record behind its trigger.
    """
    found, needed_s = [], minimum_after_isw_s(settings)
    if not inelasticity <= GREATEST_INELASTICITY:
        found.append(
            f"Zener's inelasticity is {inelasticity:.2f}, above {GREATEST_INELASTICITY}: the plate swallows "
            "the wave; take smaller or lighter spheres"
        )
    if not amplitude_ratio >= LEAST_RATIO:
        found.append(
            f"the amplitude ratio is {amplitude_ratio:.2f}, below {LEAST_RATIO}: take larger spheres against "
            "damping, smaller ones on a thin plate"
        )
    if not chain.tof_widths >= LEAST_TOF_WIDTHS:
        found.append(
            f"the reflected wave follows the incident one after {chain.tof_widths:.1f} of its widths, below "
            f"{LEAST_TOF_WIDTHS}: they overlap; put more spheres below the sensor"
        )
    if not chain.precompression_ratio <= GREATEST_PRECOMPRESSION:
        found.append(
            f"the precompression is {chain.precompression_ratio:.1f} times the incident wave's force, above "
            f"{GREATEST_PRECOMPRESSION:g}: the wave spreads; press less"
        )
    if not after_trigger_s >= needed_s:
        found.append(
            f"the record lasts {1e6 * after_trigger_s:.0f} us after its trigger, below "
            f"{1e6 * needed_s:.0f} us: record longer"
        )
    return found
