"""The last sphere as a rigid mass on Hertz's contact, against the elastic sphere that the force accelerates.

Hertz's law holds the dimple of a half-space. What an elastic sphere yields beyond that, while the force on
its pole accelerates it as a whole, is summed here from exact solutions for each Legendre polynomial of the
load (Lurie 1964, Three-Dimensional Problems of the Theory of Elasticity). It is quasi-static: the slowest
spheroidal vibration, omega R / c_s = 2.64 (Lamb 1882, doi:10.1112/plms/s1-13.1.189), is near 140 kHz.
"""

from dataclasses import replace

import numpy as np
import pytest

from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters, SolidMesh
from simulator.plate.solid.contact import transform_hertz_pressure
from simulator.plate.solid.reduction import find_solid_modes, make_modes_passive
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses

E_PA, NU, RADIUS_M, DENSITY = 200e9, 0.3, 9.525e-3, 7790.0
SHEAR_PA = E_PA / (2.0 * (1.0 + NU))
CONTACT_RADIUS_M = 2e-4


def pole_flexibility(n):
    """Radial displacement per normal load ``P_n(cos theta)`` on the surface, in units of R over G; n >= 2.

    Without shear on the surface, the solutions ``r^(n+1)`` and ``r^(n-1)`` combine to this.
    """
    n = np.asarray(n, dtype=float)
    stress = -2.0 * (n**2 + n * (1.0 + 2.0 * NU) + 1.0 + NU)
    yielding = (n + 1.0) * (n - 2.0 + 4.0 * NU) - n * (n**2 + 2.0 * n - 1.0 + 2.0 * NU) / (n - 1.0)
    return yielding / stress / 2.0


def extra_compliance_m_per_n(contact_radius_m):
    """What the accelerated sphere yields from pole to centre of mass, less the half-space's dimple."""
    n = np.arange(int(200.0 * RADIUS_M / contact_radius_m))
    flexibility = np.empty(len(n))
    lame = 2.0 * SHEAR_PA * NU / (1.0 - 2.0 * NU)
    flexibility[0] = (1.0 - 2.0 * NU) / E_PA  # pressed evenly
    flexibility[1] = 1.2 / (6.0 * lame + 4.0 * SHEAR_PA)  # accelerated, seen from the centre of mass
    flexibility[2:] = pole_flexibility(n[2:]) / SHEAR_PA
    half_space = 2.0 * (1.0 - NU**2) / E_PA / (n + 0.5)
    weight = (2.0 * n + 1.0) / (4.0 * np.pi * RADIUS_M)
    spread = transform_hertz_pressure((n + 0.5) * contact_radius_m / RADIUS_M) ** 2
    return float(np.sum(weight * (flexibility - half_space) * spread))


def test_short_waves_see_a_half_space():
    n = 1e6
    assert pole_flexibility(n) / SHEAR_PA == pytest.approx(2.0 * (1.0 - NU**2) / E_PA / n, rel=1e-5)


@pytest.mark.parametrize("n", [2.0, 3.0, 17.0])
def test_flexibility_solves_the_equations_of_elasticity(n):
    """Radius and shear modulus one, ``u_r = U r^k P_n``, ``u_theta = V r^k dP_n``, and Navier's equation."""
    lame = 2.0 * NU / (1.0 - 2.0 * NU)
    normal, shear, radial = [], [], []
    for k, u, v in ((n + 1.0, (n + 1.0) * (n - 2.0 + 4.0 * NU), n + 5.0 - 4.0 * NU), (n - 1.0, n, 1.0)):
        dilatation = (k + 2.0) * u - n * (n + 1.0) * v
        rotation = (k + 1.0) * v - u
        size = (lame + 2.0) * (abs((k + 2.0) * u) + n * (n + 1.0) * abs(v)) * n
        assert abs((lame + 2.0) * (k - 1.0) * dilatation + n * (n + 1.0) * rotation) < 1e-13 * size
        assert abs((lame + 2.0) * dilatation + k * rotation) < 1e-13 * size
        normal.append(lame * dilatation + 2.0 * k * u)
        shear.append(u + (k - 1.0) * v)
        radial.append(u)
    parts = np.linalg.solve([normal, shear], [1.0, 0.0])
    assert pole_flexibility(n) == pytest.approx(parts @ radial, rel=1e-12)


def test_accelerated_sphere_yields_less_than_the_half_space():
    extra = extra_compliance_m_per_n(CONTACT_RADIUS_M)
    dimple = 0.6 * (1.0 - NU**2) / (E_PA * CONTACT_RADIUS_M)
    assert extra / dimple == pytest.approx(-0.0109, abs=1e-4)  # quoted in the docs


def test_slowest_vibration_is_far_above_the_wave():
    frequency_hz = 2.64 * np.sqrt(SHEAR_PA / DENSITY) / (2.0 * np.pi * RADIUS_M)
    assert frequency_hz == pytest.approx(138.5e3, rel=5e-3)
    # A solitary wave of the paper's chain has little above 20 kHz: (20 / 138)^2 is 2 % of a small correction.


class OneDepth:
    def __init__(self, modes):
        self.modes = lambda depth_fraction: modes


@pytest.mark.parametrize(
    ("depth", "shift_us"), [(0.0, -0.35), pytest.param(0.8, -0.12, marks=pytest.mark.slow)]
)
def test_what_the_rigid_mass_neglects(depth, shift_us):
    """The sphere's own yielding in series with the plate's: its change of the reflected wave."""
    extra = extra_compliance_m_per_n(CONTACT_RADIUS_M)
    plate = PlateParameters(model="solid", solid=SolidMesh(edge_element=0.2, growth=3.0))
    patch = CorrosionParameters(depth_fraction=depth)
    rigid = find_solid_modes(plate, patch)
    both = make_modes_passive(
        replace(rigid, residual_compliance_m_per_n=rigid.residual_compliance_m_per_n + extra)
    )
    found = []
    for modes in (rigid, both):
        model = ShotModel(ChainParameters(), plate, patch, prepared_plate=OneDepth(modes))
        found.append(summarise_pulses(model.shot()))
    assert found[1].tof_us - found[0].tof_us == pytest.approx(shift_us, abs=0.01)  # quoted in the docs
    assert abs(found[1].amplitude_ratio - found[0].amplitude_ratio) < 1.1e-3
