"""Eq. 8 against an independent method and closed forms; bounds and errors of Zener's model."""

import math

import pytest
from scipy.special import beta

from simulator.errors import IntegrationError, SpecimenError
from simulator.parameters.chain import ChainParameters, SphereParameters
from simulator.parameters.plate import LiquidParameters, PlateParameters
from simulator.zener import model as zener
from simulator.zener.model import (
    approximate_contact_time,
    approximate_restitution,
    compute_reflection,
    inelasticity_parameter,
    solve_impact,
    time_of_flight_s,
)

STEEL = {
    "incident_speed_m_per_s": 0.2136,
    "radius_m": 9.525e-3,
    "sphere_density_kg_per_m3": 7800.0,
    "sphere_youngs_modulus_pa": 200e9,
    "sphere_poisson_ratio": 0.3,
    "thickness_m": 6.35e-3,
    "plate_density_kg_per_m3": 7800.0,
    "plate_youngs_modulus_pa": 200e9,
    "plate_poisson_ratio": 0.3,
}
FLIGHT = {
    "restitution": 0.65,
    "contact_time": 3.4,
    "spheres_below": 4,
    "mass_kg": 28.2e-3,
    "sphere_stiffness": 1e10,
    "plate_stiffness": 1.4e10,
    "impact_speed_m_per_s": 0.31,
}
LARGEST_APPROACH = 1.25**0.4
"""sigma at lambda = 0, from ``1/2 = (2/5) sigma^(5/2)``."""


def runge_kutta(inelasticity, step):
    """Eq. 8 as printed, in approach and its rate, by classic Runge-Kutta with a fixed step."""

    def slope(sigma, rate):
        root = math.sqrt(max(sigma, 0.0))
        return rate, -(root**3) - inelasticity * 1.5 * root * rate

    sigma, rate, tau = 0.0, 1.0, 0.0
    while True:
        a = slope(sigma, rate)
        b = slope(sigma + step / 2 * a[0], rate + step / 2 * a[1])
        c = slope(sigma + step / 2 * b[0], rate + step / 2 * b[1])
        d = slope(sigma + step * c[0], rate + step * c[1])
        after = sigma + step / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
        if after <= 0.0:
            break
        rate += step / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
        sigma, tau = after, tau + step
    # Less than a step before the end only lambda's part changes the rate, by lambda sigma^(3/2) exactly.
    speed = rate + inelasticity * sigma**1.5
    return -speed, tau + sigma / -speed


@pytest.mark.parametrize("inelasticity", [0.1, 0.258, 0.5, 1.0, 1.5, 2.0])
def test_an_independent_method_converges_to_the_same(inelasticity):
    coarse, fine = (runge_kutta(inelasticity, step) for step in (2e-3, 1e-3))
    found = solve_impact(inelasticity)
    for rough, better, ours in zip(coarse, fine, (found.restitution, found.contact_time), strict=True):
        # The square root in eq. 8's damping limits the reference to order 3/2: 2.83 a halving. A fifth
        # off is allowed for the next order; ours, if wrong, would not be the limit at all.
        assert (rough - ours) / (better - ours) == pytest.approx(2.0**1.5, rel=0.2)
        # Richardson's extrapolation leaves a tenth of the fine error, at most 2.6e-6 at lambda = 2.
        assert better + (better - rough) / (2.0**1.5 - 1.0) == pytest.approx(ours, abs=3e-7)


def test_without_a_plate_that_moves_it_is_hertz():
    """lambda = 0: e = 1 and ``tau_c = (4/5) sigma_max B(2/5, 1/2)``."""
    found = solve_impact(0.0)
    # The tolerance of a step is 1e-12; some fifty steps.
    assert found.restitution == pytest.approx(1.0, abs=1e-11)
    assert found.contact_time == pytest.approx(0.8 * LARGEST_APPROACH * beta(0.4, 0.5), rel=1e-11)


def test_a_stiff_plate_takes_what_the_elastic_force_radiates():
    """Small lambda: ``1 - e = lambda int sigma^3 dtau`` with the elastic sigma, again a beta function."""
    taken = 0.8 * LARGEST_APPROACH**4 * beta(1.6, 0.5)
    # The next term is about 1.7 lambda relatively: 1.7e-6.
    assert (1.0 - solve_impact(1e-6).restitution) / 1e-6 == pytest.approx(taken, rel=3e-6)


def test_on_a_thin_plate_the_rebound_falls_with_the_fifth_power():
    """The end forgets the start: e lambda^5 is one constant, and keeps its digits down to 1e-9."""
    for inelasticity in (20.0, 60.0):
        # Six digits are documented.
        assert solve_impact(inelasticity).restitution * inelasticity**5 == pytest.approx(0.679293, abs=1e-6)


@pytest.mark.parametrize("inelasticity", [0.0, 0.258, 1.0, 2.0, 6.46])
def test_the_solution_states_its_error(inelasticity):
    found = solve_impact(inelasticity)
    assert abs(found.energy_residual) < 1e-11
    assert found.difference < 1e-9


@pytest.mark.parametrize("inelasticity", [-1e-9, 200.1, math.nan, math.inf])
def test_an_inelasticity_out_of_bounds_is_refused(inelasticity):
    with pytest.raises(SpecimenError, match=r"it must lie between 0 and 200: make the plate thicker"):
        solve_impact(inelasticity)


def test_a_solution_that_does_not_converge_gives_no_numbers():
    with pytest.raises(IntegrationError, match="two tolerances differ by"):
        solve_impact(0.5, tolerance=1e-4)


def test_tolerances_that_disagree_give_no_numbers_although_the_energy_balances(monkeypatch):
    monkeypatch.setattr(zener, "_integrate_impact", lambda _, tolerance: (0.65, 3.4 + 1e5 * tolerance, 0.0))
    with pytest.raises(IntegrationError, match=r"two tolerances differ by 2\.9e-06"):
        solve_impact(0.258)


def test_a_lost_energy_gives_no_numbers(monkeypatch):
    monkeypatch.setattr(zener, "_integrate_impact", lambda *_: (0.65, 3.4, 1e-6))
    with pytest.raises(IntegrationError, match="the energy by 1e-06"):
        solve_impact(0.258)


def test_bodies_that_never_part_give_no_numbers(monkeypatch):
    original = zener.solve_ivp

    def cut_short(slope, span, *arguments, **options):
        return original(slope, (span[0], 1.0), *arguments, **options)

    monkeypatch.setattr(zener, "solve_ivp", cut_short)
    with pytest.raises(IntegrationError, match="did not separate"):
        solve_impact(0.258)


def test_closed_forms_are_refused_beyond_their_range():
    assert approximate_restitution(1.0) == math.exp(-1.6605)
    assert approximate_contact_time(0.0) == pytest.approx(2.762 + 0.4568, rel=1e-15)
    with pytest.raises(SpecimenError, match="between 0 and 1: use solve_impact"):
        approximate_restitution(1.001)
    with pytest.raises(SpecimenError, match="between 0 and 2: use solve_impact"):
        approximate_contact_time(2.001)
    with pytest.raises(SpecimenError, match="between 0 and 1"):
        compute_reflection(ChainParameters(), PlateParameters(), depth_fraction=0.5, closed_form=True)


@pytest.mark.parametrize("name", sorted(STEEL))
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_equation_9_refuses_what_cannot_be(name, value):
    assert inelasticity_parameter(**STEEL) == pytest.approx(0.2585, abs=5e-4)
    with pytest.raises(ValueError, match=name):
        inelasticity_parameter(**{**STEEL, name: value})


@pytest.mark.parametrize("name", sorted(FLIGHT))
@pytest.mark.parametrize("value", [math.nan, math.inf, 0])
def test_equation_13_refuses_what_cannot_be(name, value):
    assert time_of_flight_s(**FLIGHT) > 0.0
    with pytest.raises(ValueError, match=name):
        time_of_flight_s(**{**FLIGHT, name: value})


def test_equation_13_by_hand():
    # 1e10^-0.4 = 1e-4; with m = 1 kg, v = 1 m/s and e = 1 only the bracket is left; 32^(1/5) = 2.
    plain = {**FLIGHT, "restitution": 1.0, "mass_kg": 1.0, "impact_speed_m_per_s": 1.0}
    plain |= {"plate_stiffness": 1e10, "contact_time": 3.0}
    assert time_of_flight_s(**plain) == pytest.approx((1.18 * 2 * 4 + 1.08 * 3.0) * 1e-4, rel=1e-14)
    assert time_of_flight_s(**{**plain, "mass_kg": 32.0}) == pytest.approx(
        4.0 * time_of_flight_s(**plain), rel=1e-14
    )
    assert time_of_flight_s(**{**plain, "impact_speed_m_per_s": 32.0}) == pytest.approx(
        0.5 * time_of_flight_s(**plain), rel=1e-14
    )
    assert time_of_flight_s(**{**plain, "restitution": 1 / 32}) == pytest.approx(
        (1.18 * 3 * 4 + 1.08 * 3.0) * 1e-4, rel=1e-14
    )


def test_a_plate_too_thin_for_the_spheres_is_refused():
    with pytest.raises(SpecimenError, match="make the plate thicker"):
        compute_reflection(ChainParameters(), PlateParameters(thickness_m=1e-4))
    with pytest.raises(SpecimenError, match="is inf"):
        compute_reflection(ChainParameters(), PlateParameters(thickness_m=1e-200))


def test_a_depth_out_of_bounds_is_refused():
    with pytest.raises(ValueError, match=r"depth_fraction is 0\.96; it must be at most 0\.95"):
        compute_reflection(ChainParameters(), PlateParameters(), depth_fraction=0.96)


def test_unsupported_parameters_are_ignored():
    plain = compute_reflection(ChainParameters(), PlateParameters())
    other = compute_reflection(
        ChainParameters(sensor="sphere", tilt_rad=0.02, damping_n_s_per_m=0.0, gravity_m_per_s2=0.0),
        PlateParameters(width_m=1.2, support="clamped", model="rigid_wall"),
    )
    assert other == plain


def test_unlike_spheres_are_refused_and_warm_ones_are_softer():
    with pytest.raises(SpecimenError, match="Zener's model knows equal spheres only"):
        compute_reflection(
            ChainParameters(spheres=(SphereParameters(body=1, radius_m=8e-3),)), PlateParameters()
        )
    warm = compute_reflection(ChainParameters(temperature_c=120.0), PlateParameters())
    assert warm == compute_reflection(
        ChainParameters(youngs_modulus_pa=200e9 * (1 - 0.027)), PlateParameters()
    )


@pytest.mark.parametrize(
    ("chain", "plate", "key"),
    [
        (ChainParameters(precompression_n=5.0), PlateParameters(), "chain.precompression_n"),
        (ChainParameters(), PlateParameters(liquid=LiquidParameters(depth_m=0.1)), "plate.liquid"),
    ],
)
def test_parameters_that_the_model_does_not_support_are_refused(chain, plate, key):
    with pytest.raises(SpecimenError, match=f"{key}.*take it out, or use the coupled model"):
        compute_reflection(chain, plate)
