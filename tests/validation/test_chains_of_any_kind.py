"""Mixed spheres, damping laws, precompression, any sensor: against closed forms and another integrator."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.parameters.chain import ChainParameters, SphereParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot import side_by_side
from simulator.shot.model import ENERGY_TOLERANCE, ShotModel

PATCH = CorrosionParameters()
WALL = PlateParameters(model="rigid_wall")
RADIUS_M, MASS_KG, MODULUS_PA, POISSON = 9.525e-3, 28.2e-3, 200e9, 0.3
EXPONENTS = {"linear": 0.0, "tsuji": 0.25, "kuwabara_kono": 0.5, "hunt_crossley": 1.5}
LAWS = list(EXPONENTS)
UNDAMPED = ChainParameters(sensor="sphere", damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0)
PAIR = replace(UNDAMPED, spheres_above=1, spheres_below=0, gravity_m_per_s2=0.0)
"""Striker and sensor sphere; above a hole they are two free bodies."""
MIXED = (
    SphereParameters(body=0, mass_kg=50e-3),
    SphereParameters(body=2, last_body=3, radius_m=7e-3, density_kg_per_m3=4500.0, youngs_modulus_pa=110e9),
    SphereParameters(body=6, youngs_modulus_pa=70e9, poisson_ratio=0.33, mass_kg=10e-3),
    SphereParameters(body=8, radius_m=12e-3),
)


def pair_stiffness(radius_1, modulus_1, nu_1, radius_2, modulus_2, nu_2):
    """Hertz's constant by its textbook formula; infinity for a flat."""
    compliance = (1 - nu_1**2) / modulus_1 + (1 - nu_2**2) / modulus_2
    return 4.0 / 3.0 / compliance / math.sqrt(1.0 / radius_1 + 1.0 / radius_2)


def bare_law(mass, stiffness, gamma, exponent, reference_m, speed, time_s, load):
    """Forces at all contacts from the law (A d^1.5 + gamma (d / d_r)^p d_dot) H(d), DOP853.

    Absolute positions and full loads: nothing of the model but the numbers of the bodies.
    """
    n = len(mass)
    static = 9.81 * (np.cumsum(mass) - mass[0])
    static[1:] += load
    overlap = (static / stiffness) ** (2 / 3)
    x = np.append(np.cumsum(overlap[::-1])[::-1], 0.0)  # the wall at zero
    pull = 9.81 * np.asarray(mass)
    pull[1] += load

    def forces(y):
        d = y[:n] - np.append(y[1:n], 0.0)
        rate = y[n:] - np.append(y[n + 1 :], 0.0)
        pressed = np.maximum(d, 0.0)
        # d^0 is 1, also at an open contact: the last factor opens it.
        dashpot = gamma * (pressed / reference_m) ** exponent * rate * (d > 0.0)
        return stiffness * pressed**1.5 + dashpot

    def derivative(_, y):
        force = forces(y)
        return np.concatenate((y[n:], (pull - force + np.append(0.0, force[:-1])) / mass))

    start = np.concatenate((x[:n], [speed], np.zeros(n - 1)))
    # Steps of at most 1 us: the force jumps where a linear dashpot lets go, and each jump is sought out.
    found = solve_ivp(
        derivative, (0.0, time_s[-1]), start, "DOP853", t_eval=time_s, rtol=1e-10, atol=1e-14, max_step=1e-6
    )
    assert found.success
    return np.array([forces(y) for y in found.y.T]).T


def relative_l2(values, reference):
    return np.linalg.norm(values - reference) / np.linalg.norm(reference)


@pytest.mark.parametrize("ratio", [0.05, 0.5, 1.0, 3.0, 40.0])
def test_two_unlike_spheres_exchange_momentum_and_energy(ratio):
    """Elastic collision: impulse 2 mu v, largest force and duration of Hertz (Johnson 1985, section 11.4)."""
    radius = RADIUS_M * ratio ** (1 / 3)
    chain = replace(PAIR, spheres=(SphereParameters(body=1, radius_m=radius, youngs_modulus_pa=100e9),))
    model = ShotModel(chain, WALL, PATCH, step_s=1e-7, duration_s=0.4e-3)
    force = model.shot(through_hole=True, contact_forces=True)
    struck_by = force.contact_force_n[0]
    mu = MASS_KG * ratio / (1.0 + ratio)
    speed = math.sqrt(2 * 9.81 * 5e-3)
    stiffness = pair_stiffness(RADIUS_M, 200e9, 0.3, radius, 100e9, 0.3)
    deepest = (1.25 * mu * speed**2 / stiffness) ** 0.4
    duration = 2 * math.sqrt(math.pi) * math.gamma(1.4) / math.gamma(0.9) * deepest / speed
    impulse = np.trapezoid(struck_by, force.time_s)
    # Steps of 1e-7 s in a contact of 1e-4 s: order 5/2 at touch and release.
    assert impulse == pytest.approx(2 * mu * speed, rel=1e-6)
    # The highest sample is up to half a step from the peak.
    assert struck_by.max() == pytest.approx(stiffness * deepest**1.5, rel=1e-5)
    assert force.time_s[np.flatnonzero(struck_by)[-1]] == pytest.approx(duration, abs=2e-7)  # the sampling
    striker = speed - impulse / MASS_KG
    other = impulse / (ratio * MASS_KG)
    energy = 0.5 * MASS_KG * (striker**2 + ratio * other**2)
    assert energy == pytest.approx(0.5 * MASS_KG * speed**2, rel=1e-6)
    assert not force.contact_force_n[1].any()  # nothing below


CHANGES = {
    "tsuji": ("uniform", {}),
    "linear": ("mixed", {"spheres": MIXED}),
    "hunt_crossley": (
        "precompressed, sensor below the striker",
        {"precompression_n": 40.0, "spheres_above": 1, "spheres_below": 3},
    ),
    "kuwabara_kono": ("sensor on the wall", {"spheres_above": 3, "spheres_below": 0}),
}
"""Each with the law of damping that the default run takes; the slow run takes the other ones, too."""


@pytest.mark.parametrize(
    ("law", "changes"),
    [
        pytest.param(law, changes, id=f"{name}-{law}", marks=[pytest.mark.slow] * (law != default))
        for default, (name, changes) in CHANGES.items()
        for law in LAWS
    ],
)
def test_agrees_with_an_integration_of_the_bare_law(law, changes):
    chain = ChainParameters(sensor="sphere", damping_n_s_per_m=20.0, damping_law=law, **changes)
    force = ShotModel(chain, WALL, PATCH, duration_s=0.8e-3).shot(contact_forces=True)
    n = chain.bodies
    radius, mass = np.full(n, RADIUS_M), np.full(n, MASS_KG)
    modulus, nu = np.full(n, MODULUS_PA), np.full(n, POISSON)
    if "spheres" in changes:
        mass[0] = 50e-3
        radius[2:4], mass[2:4], modulus[2:4] = 7e-3, 4500.0 * 4 / 3 * math.pi * 7e-3**3, 110e9
        modulus[6], nu[6], mass[6] = 70e9, 0.33, 10e-3
        radius[8], mass[8] = 12e-3, MASS_KG * (12 / 9.525) ** 3
    stiffness = [
        pair_stiffness(radius[i], modulus[i], nu[i], radius[i + 1], modulus[i + 1], nu[i + 1])
        for i in range(n - 1)
    ]
    stiffness.append(pair_stiffness(radius[-1], modulus[-1], nu[-1], math.inf, 200e9, 0.3))
    reference = bare_law(
        mass,
        np.array(stiffness),
        np.append(np.full(n - 1, 20.0), 34.05),
        EXPONENTS[law],
        1e-5,
        math.sqrt(2 * 9.81 * 5e-3),
        force.time_s,
        chain.precompression_n,
    )
    sensor = chain.spheres_above
    expected = 0.5 * (reference[sensor - 1] + reference[sensor])
    assert relative_l2(force.force_n, expected) < 1e-4  # the allowance of a waveform
    # The same for every contact; one that jumps open with a linear dashpot may do so a sample aside.
    for found, wanted in zip(force.contact_force_n, reference, strict=True):
        assert relative_l2(found, wanted) < 3e-4
    at_sensor = 0.5 * (force.contact_force_n[sensor - 1] + force.contact_force_n[sensor])
    np.testing.assert_allclose(force.force_n, at_sensor, rtol=1e-12, atol=1e-12)  # the same sum


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("depth", [0.0, 0.6])
def test_energy_balances_for_every_law_on_a_plate_at_every_step(reduction_folder, monkeypatch, law, depth):
    monkeypatch.setattr(side_by_side, "ENERGY_INTERVAL_STEPS", 1)
    chain = ChainParameters(damping_law=law, damping_n_s_per_m=20.0, precompression_n=5.0, spheres=MIXED[2:])
    plate = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
    force = ShotModel(chain, plate, PATCH, cache_folder=reduction_folder).shot(depth_fraction=depth)
    assert force.energy_residual <= ENERGY_TOLERANCE
    assert force.step_s == force.time_s[1]  # never halved


def test_a_weak_pulse_runs_through_a_pressed_chain_as_through_springs():
    """``c = 2 R sqrt(k / m)``, ``k = 1.5 A d_0^0.5``: Nesterenko 2001, section 1.3, long waves."""
    for load_n, bound in ((100.0, 0.01), (1000.0, 0.01)):
        chain = replace(
            UNDAMPED,
            spheres_above=40,
            spheres_below=60,
            gravity_m_per_s2=0.0,
            precompression_n=load_n,
            drop_height_m=1e-8,
            # A heavy striker makes a pulse that is long compared with a sphere.
            spheres=(SphereParameters(body=0, mass_kg=100 * MASS_KG, radius_m=5 * RADIUS_M),),
        )
        stiffness = pair_stiffness(RADIUS_M, MODULUS_PA, POISSON, RADIUS_M, MODULUS_PA, POISSON)
        per_sphere = math.sqrt(MASS_KG / (1.5 * stiffness ** (2 / 3) * load_n ** (1 / 3)))
        model = ShotModel(chain, WALL, PATCH, step_s=1e-6, duration_s=100 * per_sphere)
        force = model.shot(contact_forces=True)
        arrivals = []
        for contact in (30, 60):
            pulse = force.contact_force_n[contact] - load_n
            assert pulse.max() < 0.01 * load_n  # weak
            front = slice(0, int(np.argmax(pulse)) + 1)
            arrivals.append(np.interp(0.5 * pulse.max(), pulse[front], force.time_s[front]))
        assert (arrivals[1] - arrivals[0]) / 30 == pytest.approx(per_sphere, rel=bound)


def test_a_heavy_chain_passes_its_pulse_on_to_a_light_one_as_a_train():
    """Nesterenko 2001, section 1.6: heavy to light splits, light to heavy throws back."""
    light = {"mass_kg": MASS_KG / 8, "radius_m": RADIUS_M / 2}

    def pulses(first, last, contact):
        chain = replace(
            UNDAMPED,
            spheres_above=20,
            spheres_below=30,
            gravity_m_per_s2=0.0,
            spheres=(SphereParameters(body=first, last_body=last, **light),),
        )
        force = ShotModel(chain, WALL, PATCH, duration_s=1.0e-3).shot(contact_forces=True)
        f = force.contact_force_n[contact]
        peaks = np.flatnonzero((f[1:-1] > f[:-2]) & (f[1:-1] >= f[2:])) + 1
        return f[peaks][f[peaks] > 0.02 * f.max()]

    train = pulses(15, 50, 30)
    assert len(train) >= 3
    assert np.all(np.diff(train) < 0.0)  # the strongest runs ahead
    assert len(pulses(0, 14, 25)) == 1  # one transmitted pulse, and all that is transmitted
    there_and_back = pulses(0, 14, 7)
    assert len(there_and_back) >= 2
