"""The chain of spheres with its sensor: masses, contacts, static equilibrium (paper, equations 1-2).

Body i = 0 is the striker, contact i lies between body i and body i + 1, the last contact between the
last sphere and the specimen. The force of a contact with overlap d is

    F = (A d^(3/2) + gamma (d / d_r)^p dd/dt) H(d)

with Heaviside's step H: for p = 0 equation 1 with the dashpot's units put right; p = 1/4 is the law of
Tsuji (doi:10.1016/0032-5910(92)88030-L), 1/2 of Kuwabara and Kono (doi:10.1143/JJAP.26.1230), 3/2 of Hunt
and Crossley (doi:10.1115/1.3423596). d_r is a reference overlap, so that gamma is in N s/m throughout; a
published constant in N s/m^(1 + p) is ``gamma / d_r^p``. The law is used as it stands:
while two bodies part, the dashpot may pull harder than the spring pushes, and F turns slightly
negative just before d = 0 (below 1 % of the peak with the paper's gamma). Its impulse from touch to
release is zero, ``integral gamma (d / d_r)^p dd/dt H(d) dt = gamma [d]_+^(p + 1) / ((p + 1) d_r^p)``, which
is what the integrator uses.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.chain.hertz_contact import Surface, contact_stiffness, indentation_m
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import PlateParameters

FREE_FALL_M_PER_S2 = 9.81
"""Sets the striker's speed, also in a chain without gravity."""

TILT_DAMPING_PER_RAD2 = 2.5e4
"""Our assumption: see `tilted_damping`."""

DAMPING_EXPONENTS = {"linear": 0.0, "tsuji": 0.25, "kuwabara_kono": 0.5, "hunt_crossley": 1.5}
"""p of `ChainParameters.damping_law`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chain:
    """Chain ready for integration.

    Attributes
    ----------
    mass_kg
        float64, shape (n_bodies,), striker first.
    stiffness_n_per_m15
        float64, shape (n_bodies,): A of the contact below each body, N/m^1.5.
    damping_n_s_per_m
        float64, shape (n_bodies,): gamma of the same contacts, at the reference overlap.
    static_force_n
        float64, shape (n_bodies,): weight and precompression carried by each contact before the strike;
        none under the striker.
    static_overlap_m
        float64, shape (n_bodies,): d of the same contacts.
    gravity_m_per_s2
        Acts on every body.
    impact_speed_m_per_s
        ``sqrt(2 g h_s)``.
    sensor
        Index of the sensor's body: its two contacts are ``sensor - 1`` and ``sensor``.
    precompression_n
        Constant force on the body below the striker.
    damping_exponent, damping_reference_overlap_m
        p and d_r of the dashpots.
    second_delay_s, second_speed_m_per_s
        A second impact of the striker: so long after the first, with this speed; None: there is none.
    """

    mass_kg: NDArray[np.float64]
    stiffness_n_per_m15: NDArray[np.float64]
    damping_n_s_per_m: NDArray[np.float64]
    static_force_n: NDArray[np.float64]
    static_overlap_m: NDArray[np.float64]
    gravity_m_per_s2: float
    impact_speed_m_per_s: float
    sensor: int
    precompression_n: float = 0.0
    damping_exponent: float = 0.0
    damping_reference_overlap_m: float = 1.0
    second_delay_s: float | None = None
    second_speed_m_per_s: float = 0.0

    @property
    def dashpot_impulse_n_s_per_m(self) -> NDArray[np.float64]:
        """Return ``gamma / ((p + 1) d_r^p)`` of each contact, shape (n_bodies,).

        gamma, p and d_r are the dashpot's constant, exponent and reference overlap. Multiplied by [d]_+^(p +
        1), d the overlap, it is the impulse of the dashpots.
        """
        p = self.damping_exponent
        scale: float = 1.0 / ((p + 1.0) * self.damping_reference_overlap_m**p)
        return scale * self.damping_n_s_per_m

    @property
    def impact_energy_j(self) -> float:
        """Return the kinetic energy of the striker at first touch, in J."""
        return 0.5 * float(self.mass_kg[0]) * self.impact_speed_m_per_s**2

    @property
    def preload_n(self) -> float:
        """Return the mean of the two static contact forces at the sensor, in N."""
        return 0.5 * float(self.static_force_n[self.sensor - 1] + self.static_force_n[self.sensor])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """Deviations of one strike's contacts from the nominal ones.

    Attributes
    ----------
    stiffness_factor, damping_factor
        float64, shape (n_bodies,): A and gamma of the contact below each body, over the nominal ones.
    """

    stiffness_factor: NDArray[np.float64]
    damping_factor: NDArray[np.float64]


def tilted_damping(damping_n_s_per_m: float, tilt_rad: float) -> float:
    """Return the dashpot of a sensor disk's face that is tilted by `tilt_rad`, in N s/m.

    ``gamma_face = gamma (1 + k tilt^2)``. A tilted disk slides on its spheres while they press on it,
    and friction takes energy. The form is our assumption: even in the tilt, nothing at zero. The
    constant k = `TILT_DAMPING_PER_RAD2` is sized so that 1.0 +- 0.2 degrees scatter the amplitude
    ratio by 2.5 % and the time of flight by a small fraction of that.
    """
    return damping_n_s_per_m * (1.0 + TILT_DAMPING_PER_RAD2 * tilt_rad**2)


def build_chain(parameters: ChainParameters, plate: PlateParameters) -> Chain:
    """Build the chain on `plate`: masses, contacts and static equilibrium.

    The plate's Young's modulus and Poisson's ratio enter the last contact.
    Raise ValueError if two flat faces touch.
    """
    sensor = parameters.spheres_above
    bodies = [parameters.body(i) for i in range(parameters.bodies)]
    stiffness = np.array([contact_stiffness(*surfaces) for surfaces in list_contacts(parameters, plate)])
    damping = np.full(len(bodies), parameters.damping_n_s_per_m, dtype=np.float64)
    damping[sensor - 1 : sensor + 1] = tilted_damping(parameters.damping_n_s_per_m, parameters.tilt_rad)
    damping[-1] = parameters.contact_damping_n_s_per_m

    mass = np.array([body.mass_kg for body in bodies])
    weight = mass * parameters.gravity_m_per_s2
    static_force = np.cumsum(weight) - weight[0]
    static_force[1:] += parameters.precompression_n
    overlap = np.array([indentation_m(f, a) for f, a in zip(static_force, stiffness, strict=True)])
    return Chain(
        mass_kg=mass,
        stiffness_n_per_m15=stiffness,
        damping_n_s_per_m=damping,
        static_force_n=static_force,
        static_overlap_m=overlap,
        gravity_m_per_s2=parameters.gravity_m_per_s2,
        impact_speed_m_per_s=impact_speed_m_per_s(parameters.drop_height_m),
        sensor=sensor,
        precompression_n=parameters.precompression_n,
        damping_exponent=DAMPING_EXPONENTS[parameters.damping_law],
        damping_reference_overlap_m=parameters.damping_reference_overlap_m,
    )


def list_contacts(parameters: ChainParameters, plate: PlateParameters) -> list[tuple[Surface, Surface]]:
    """Return the upper and lower surface of the contact below each body, that with the plate last."""
    surfaces = [
        Surface(
            radius_m=body.radius_m,
            youngs_modulus_pa=body.youngs_modulus_pa,
            poisson_ratio=body.poisson_ratio,
        )
        for body in map(parameters.body, range(parameters.bodies))
    ]
    surfaces.append(
        Surface(
            radius_m=math.inf,
            youngs_modulus_pa=plate.warm_youngs_modulus_pa,
            poisson_ratio=plate.poisson_ratio,
        )
    )
    return list(itertools.pairwise(surfaces))


def change_strike(
    chain: Chain, damping_n_s_per_m: float, drop_height_m: float, tilt_rad: float, contacts: Contacts | None
) -> Chain:
    """Return the chain with another drop height in m, sensor tilt in rad and contacts.

    With other contacts, the static overlaps are again those of equilibrium: ``d = (F / A)^(2/3)``.

    Parameters
    ----------
    damping_n_s_per_m
        Of the sensor's contacts, without tilt; that to the plate stays.
    contacts
        None: as they were.

    Raises
    ------
    ValueError
        The factors are not one a body, or not positive.
    """
    damping, stiffness = chain.damping_n_s_per_m.copy(), chain.stiffness_n_per_m15
    overlap, bodies = chain.static_overlap_m, chain.mass_kg.shape
    faces = slice(chain.sensor - 1, min(chain.sensor + 1, len(damping) - 1))
    damping[faces] = tilted_damping(damping_n_s_per_m, tilt_rad)
    if contacts is not None:
        for name in ("stiffness_factor", "damping_factor"):
            factor = getattr(contacts, name)
            # Also false where one is not a number.
            if factor.shape != bodies or not factor.min() > 0.0:
                raise ValueError(
                    f"{name} is {factor.tolist()}; it must be {bodies[0]} positive numbers, one a body"
                )
        stiffness = stiffness * contacts.stiffness_factor
        damping *= contacts.damping_factor
        overlap = overlap * contacts.stiffness_factor ** (-2.0 / 3.0)
    return replace(
        chain,
        stiffness_n_per_m15=stiffness,
        damping_n_s_per_m=damping,
        static_overlap_m=overlap,
        impact_speed_m_per_s=impact_speed_m_per_s(drop_height_m),
    )


def impact_speed_m_per_s(drop_height_m: float) -> float:
    """Return the speed of the falling striker at first touch, ``sqrt(2 g h)`` in m/s, g = 9.81 m/s^2."""
    return math.sqrt(2.0 * FREE_FALL_M_PER_S2 * drop_height_m)
