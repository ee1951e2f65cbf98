"""A long chain without gravity and damping, away from the striker, against solitary-wave theory."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.chain.spheres import build_chain
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses

BODIES = 60
WALL = PlateParameters(model="rigid_wall")
CHAIN = ChainParameters(
    sensor="sphere", damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0, gravity_m_per_s2=0.0
)


def chain_with_sensor_at(body, **changes):
    return replace(CHAIN, spheres_above=body, spheres_below=BODIES - 1 - body, **changes)


def isw(body, **changes):
    chain = chain_with_sensor_at(body, **changes)
    return summarise_pulses(ShotModel(chain, WALL, CorrosionParameters(), step_s=5e-7).shot())


def test_particle_speed_is_0_682_of_the_strikers():
    """Peak speed of a sphere in the steady wave: ``v_m = 0.682 v_imp`` (the paper's reference 80)."""
    chain = chain_with_sensor_at(18)
    model = ShotModel(chain, WALL, CorrosionParameters(), step_s=5e-7, duration_s=30 * 37e-6)
    forces = model.shot(contact_forces=True).contact_force_n  # the wave passes about body 30
    net = forces[19] - forces[20]  # on body 20
    speed = np.cumsum(net) * 5e-7 / chain.mass_kg
    impact_speed = build_chain(chain, WALL).impact_speed_m_per_s
    assert speed.max() / impact_speed == pytest.approx(0.682, abs=0.001)  # three digits known


def test_wave_speed_goes_with_the_sixth_root_of_the_force():
    heights = (1e-3, 5e-3, 25e-3)
    near, far = ([isw(body, drop_height_m=h) for h in heights] for body in (20, 35))
    speed = (
        15
        * 2
        * CHAIN.radius_m
        / (1e-6 * np.array([b.isw_time_us - a.isw_time_us for a, b in zip(near, far, strict=True)]))
    )
    force = np.array([a.isw_peak_n for a in near])
    exponent = np.polyfit(np.log(force), np.log(speed), 1)[0]
    # Exact by scaling; the fixed step resolves the faster waves a little less.
    assert exponent == pytest.approx(1 / 6, abs=1e-4)


def exact_pulse():
    """Overlap of a steady wave in the discrete chain, peak 1, over time in units of one contact's delay.

    ``m d'' = F(t + tau) - 2 F + F(t - tau)`` integrated twice: d is ``tau^2 / m`` times F smoothed by a
    triangle two delays wide (English and Pego 2005, doi:10.1090/S0002-9939-05-07851-2). Their iteration,
    normalised. Returns s, d and the mean G of F at the peak: ``tau = (m / (A d_m^0.5 G))^0.5``.
    """
    ds = 0.005
    s = ds * np.arange(-800, 801)
    triangle = np.maximum(1.0 - np.abs(s), 0.0) * ds
    d = np.exp(-(s**2))
    for _ in range(200):
        smoothed = np.convolve(d**1.5, triangle, mode="same")
        peak = smoothed.max()
        change = np.abs(smoothed / peak - d).max()
        d = smoothed / peak
        if change < 1e-13:
            return s, d, peak
    raise AssertionError("the iteration did not settle")


def full_width(x, y, level):
    """Distance between the two places where a pulse passes a level."""
    peak = int(np.argmax(y))
    return np.interp(-level, -y[peak:], x[peak:]) - np.interp(level, y[: peak + 1], x[: peak + 1])


@pytest.mark.parametrize("drop_height_m", [1e-3, 25e-3])
def test_speed_and_width_are_those_of_the_exact_wave(drop_height_m):
    chain = chain_with_sensor_at(30, drop_height_m=drop_height_m)
    model = ShotModel(chain, WALL, CorrosionParameters(), step_s=2e-7, duration_s=42 * 50e-6)
    force = model.shot(contact_forces=True)
    pulses = force.contact_force_n[[24, 34]]
    assert np.all(pulses[:, -1] < 1e-3 * pulses.max())  # both have passed
    middles = [
        np.average(force.time_s[f > 0.5 * f.max()], weights=f[f > 0.5 * f.max()] - 0.5 * f.max())
        for f in pulses
    ]
    delay_s = (middles[1] - middles[0]) / 10
    a = build_chain(chain, WALL).stiffness_n_per_m15[1]
    s, d, g = exact_pulse()
    overlap_m = (pulses[0].max() / a) ** (2 / 3)
    # A wave of 20 spheres' travel is steady to some 1e-4.
    assert delay_s == pytest.approx(np.sqrt(chain.mass_kg / (a * np.sqrt(overlap_m) * g)), rel=5e-4)
    for level in (0.1, 0.5, 0.9):
        found = full_width(force.time_s, pulses[0], level * pulses[0].max()) / delay_s
        assert found == pytest.approx(full_width(s, d**1.5, level), rel=2e-3)


def test_the_exact_wave_is_nearly_nesterenko_s_five_spheres():
    """His overlap goes with ``cos^4(sqrt(10) x / (5 a))``: ``5 pi / sqrt(10)``, five spheres from end to end.

    The long-wave equation is as good as a wave of five spheres is long: some per cent.
    """
    s, d, _ = exact_pulse()
    inside = np.abs(s) < 0.5 * 5 * np.pi / np.sqrt(10)
    theory = np.where(inside, np.cos(np.sqrt(10) * s / 5) ** 4, 0.0)
    assert full_width(s, d, 0.5) == pytest.approx(full_width(s, theory, 0.5), rel=0.06)
    assert np.sum(d[inside]) / np.sum(d) > 0.999
