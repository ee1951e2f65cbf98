"""The chain of spheres with its sensor: masses, contacts, static equilibrium (paper, equations 1-2).

Body i = 0 is the striker, contact i lies between body i and body i + 1, the last contact between the
last sphere and the specimen. The force of a contact with overlap d is

    F = (A d^(3/2) + gamma dd/dt) H(d)

with Heaviside's step H: equation 1 with the dashpot's units put right. The law is used as it stands:
while two bodies part, the dashpot may pull harder than the spring pushes, and F turns slightly
negative just before d = 0 (below 1 % of the peak with the paper's gamma). Its impulse from touch to
release is zero, ``integral gamma dd/dt H(d) dt = gamma [d]_+``, which is what the integrator uses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.chain_parameters import ChainParameters
from simulator.hertz_contact import indentation_m, sphere_on_flat_stiffness, sphere_on_sphere_stiffness
from simulator.plate_parameters import PlateParameters

FREE_FALL_M_PER_S2 = 9.81
"""Sets the striker's speed, also in a chain without gravity."""

TILT_DAMPING_PER_RAD2 = 2.5e4
"""Our assumption: see `tilted_damping`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chain:
    """A chain ready to be integrated.

    Attributes
    ----------
    mass_kg
        float64, shape (n_bodies,), striker first.
    stiffness_n_per_m15
        float64, shape (n_bodies,): A of the contact below each body, N/m^1.5.
    damping_n_s_per_m
        float64, shape (n_bodies,): gamma of the same contacts.
    static_force_n
        float64, shape (n_bodies,): weight carried by each contact before the strike; none under the striker.
    static_overlap_m
        float64, shape (n_bodies,): d of the same contacts.
    gravity_m_per_s2
        Acts on every body.
    impact_speed_m_per_s
        ``sqrt(2 g h_s)``.
    sensor
        Index of the sensor's body: its two contacts are ``sensor - 1`` and ``sensor``.
    """

    mass_kg: NDArray[np.float64]
    stiffness_n_per_m15: NDArray[np.float64]
    damping_n_s_per_m: NDArray[np.float64]
    static_force_n: NDArray[np.float64]
    static_overlap_m: NDArray[np.float64]
    gravity_m_per_s2: float
    impact_speed_m_per_s: float
    sensor: int

    @property
    def impact_energy_j(self) -> float:
        """Kinetic energy of the striker at first touch."""
        return 0.5 * float(self.mass_kg[0]) * self.impact_speed_m_per_s**2

    @property
    def preload_n(self) -> float:
        """Mean of the two static contact forces at the sensor."""
        return 0.5 * float(self.static_force_n[self.sensor - 1] + self.static_force_n[self.sensor])


def tilted_damping(damping_n_s_per_m: float, tilt_rad: float) -> float:
    """Dashpot of a face of the sensor disk that stands tilted by `tilt_rad`.

    ``gamma_face = gamma (1 + k tilt^2)``. A tilted disk slides on its spheres while they press on it,
    and friction takes energy. The form is our assumption: even in the tilt, nothing at zero. The
    constant k = `TILT_DAMPING_PER_RAD2` is sized so that 1.0 +- 0.2 degrees scatter the amplitude
    ratio by 2.5 % and the time of flight by a small fraction of that.
    """
    return damping_n_s_per_m * (1.0 + TILT_DAMPING_PER_RAD2 * tilt_rad**2)


def build_chain(parameters: ChainParameters, plate: PlateParameters) -> Chain:
    """Masses, contacts and static equilibrium of a chain that stands on `plate`.

    The plate's Young's modulus and Poisson's ratio enter the last contact.
    """
    sensor = parameters.spheres_above
    bodies = sensor + 1 + parameters.spheres_below
    radius, modulus, nu = parameters.radius_m, parameters.youngs_modulus_pa, parameters.poisson_ratio

    mass = np.full(bodies, parameters.mass_kg)
    stiffness = np.full(bodies, sphere_on_sphere_stiffness(radius, modulus, nu))
    damping = np.full(bodies, parameters.damping_n_s_per_m)
    if parameters.sensor == "disk":
        mass[sensor] = parameters.sensor_mass_kg
        stiffness[sensor - 1 : sensor + 1] = sphere_on_flat_stiffness(radius, modulus, nu, modulus, nu)
    damping[sensor - 1 : sensor + 1] = tilted_damping(parameters.damping_n_s_per_m, parameters.tilt_rad)
    stiffness[-1] = sphere_on_flat_stiffness(
        radius, modulus, nu, plate.youngs_modulus_pa, plate.poisson_ratio
    )
    damping[-1] = parameters.contact_damping_n_s_per_m

    weight = mass * parameters.gravity_m_per_s2
    static_force = np.cumsum(weight) - weight[0]
    overlap = np.array([indentation_m(f, a) for f, a in zip(static_force, stiffness, strict=True)])
    return Chain(
        mass_kg=mass,
        stiffness_n_per_m15=stiffness,
        damping_n_s_per_m=damping,
        static_force_n=static_force,
        static_overlap_m=overlap,
        gravity_m_per_s2=parameters.gravity_m_per_s2,
        impact_speed_m_per_s=math.sqrt(2.0 * FREE_FALL_M_PER_S2 * parameters.drop_height_m),
        sensor=sensor,
    )
