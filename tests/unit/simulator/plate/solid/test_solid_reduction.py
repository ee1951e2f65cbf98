"""Modes of the solid plate: response kept, correction under the contact, passivity, what is kept on disk."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.errors import SpecimenError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters, SolidMesh
from simulator.plate import models as plate_models
from simulator.plate.models import CachedSolid
from simulator.plate.reduced import PlateModes
from simulator.plate.solid.contact import exact_contact_compliance_m_per_n, half_space_indentation_m_per_n
from simulator.plate.solid.plate import build_solid_plate
from simulator.plate.solid.reduction import (
    contact_residual_m_per_n,
    find_solid_modes,
    krylov_fields,
    make_modes_passive,
    make_shifted_solver,
    project_layers,
)
from simulator.shot.model import ENERGY_TOLERANCE, ShotModel

COARSE = PlateParameters(
    model="solid", solid=SolidMesh(degree=3, edge_element=0.5, contact_element=1.0, largest_element=12.0)
)
PATCH = CorrosionParameters()


@pytest.mark.parametrize(("shape", "depth"), [("square", 0.0), ("round", 0.6)])
def test_projection_keeps_the_plates_response(shape, depth):
    """A growing force, by which the response of a finite time is weighed: in K + sigma^2 M."""
    plate = build_solid_plate(COARSE, replace(PATCH, shape=shape, depth_fraction=depth))
    projected = project_layers(plate, krylov_fields(plate, 60))
    modes = projected.modes(1.0 - depth, 0.0)
    for sigma in (0.0, 1e4, 6e4, 1.2e5):
        exact = plate.load @ make_shifted_solver(plate, sigma)(plate.load)
        reduced = np.sum(modes.participation**2 / (modes.omega_rad_per_s**2 + sigma**2))
        # The space is made with 6e4; at rest it must find every slow mode.
        assert reduced == pytest.approx(exact, rel=1e-9 if sigma else 1e-5)


def test_projected_layers_hold_at_another_thickness():
    """Fields of one depth, taken at another with the same grid: its own stiffness and mass."""
    plate, other = (build_solid_plate(COARSE, replace(PATCH, depth_fraction=d)) for d in (0.5, 0.7))
    # Displacements within the upper layer and its neighbour's nodes only, alike in both.
    fields = krylov_fields(plate, 5)
    here, there = project_layers(plate, fields), project_layers(other, fields)
    np.testing.assert_allclose(
        here.stiffness, there.stiffness, rtol=1e-9, atol=1e-9 * np.abs(here.stiffness).max()
    )
    np.testing.assert_allclose(here.mass, there.mass, rtol=1e-9, atol=1e-9 * np.abs(here.mass).max())


def test_contact_no_longer_depends_on_its_elements():
    """Three meshes under the contact whose own compliances differ by a tenth of the half-space's."""
    meshes = [replace(COARSE.solid, contact_element=size) for size in (0.25, 0.5, 1.0)]
    bare, corrected = [], []
    for mesh in meshes:
        plate = build_solid_plate(replace(COARSE, solid=mesh), PATCH)
        value = plate.load @ make_shifted_solver(plate, 0.0)(plate.load)
        bare.append(value)
        corrected.append(value + contact_residual_m_per_n(plate, PATCH))
    indentation = half_space_indentation_m_per_n(200e9, 0.3, COARSE.contact_radius_m)
    assert np.ptp(bare) > 0.1 * indentation
    # Growing from the contact, the meshes also differ away from it.
    assert np.ptp(corrected) < 3e-3 * indentation


def test_static_compliance_of_the_pristine_plate_is_the_exact_one():
    exact = exact_contact_compliance_m_per_n(COARSE, 0.6096, 0.6096, 6.35e-3)
    exact -= half_space_indentation_m_per_n(200e9, 0.3, COARSE.contact_radius_m)
    modes = find_solid_modes(replace(COARSE, solid=SolidMesh()), PATCH)
    assert modes.static_compliance_m_per_n == pytest.approx(exact, rel=1e-5)
    assert modes.residual_compliance_m_per_n >= 0.0


def test_passive_modes_give_up_the_fastest_until_nothing_is_negative():
    modes = PlateModes(
        omega_rad_per_s=np.array([1.0, 2.0, 4.0, 8.0]),
        participation=np.array([1.0, 2.0, 4.0, 8.0]),
        residual_compliance_m_per_n=-1.5,
    )
    passive = make_modes_passive(modes)
    assert passive.omega_rad_per_s.tolist() == [1.0, 2.0]
    assert passive.residual_compliance_m_per_n == pytest.approx(0.5, rel=1e-15)
    assert passive.static_compliance_m_per_n == pytest.approx(modes.static_compliance_m_per_n, rel=1e-15)
    unchanged = make_modes_passive(replace(modes, residual_compliance_m_per_n=0.0))
    assert unchanged.omega_rad_per_s.tolist() == [1.0, 2.0, 4.0, 8.0]
    with pytest.raises(SpecimenError, match="yields 1 m/N less than a half-space"):
        make_modes_passive(replace(modes, residual_compliance_m_per_n=-5.0))


def test_kept_modes_are_those_computed_to_the_last_bit(tmp_path, monkeypatch):
    patch = replace(PATCH, depth_fraction=0.4)
    bare = CachedSolid(COARSE, patch, None).modes(0.4)
    first = CachedSolid(COARSE, patch, tmp_path).modes(0.4)
    monkeypatch.setattr(plate_models, "find_solid_modes", None)  # from here on, only what is kept
    second = CachedSolid(COARSE, patch, tmp_path).modes(0.4)
    for modes in (first, second):
        assert modes.omega_rad_per_s.tobytes() == bare.omega_rad_per_s.tobytes()
        assert modes.participation.tobytes() == bare.participation.tobytes()
        assert modes.residual_compliance_m_per_n == bare.residual_compliance_m_per_n
    with pytest.raises(TypeError):
        CachedSolid(COARSE, patch, tmp_path).modes(0.41)
    other = replace(COARSE, solid=replace(COARSE.solid, growth=1.5))
    with pytest.raises(TypeError):
        CachedSolid(other, patch, tmp_path).modes(0.4)


@pytest.fixture(scope="module")
def shots():
    model = ShotModel(ChainParameters(), COARSE, PATCH, duration_s=1.4e-3, cache_folder=None)
    return {depth: model.shot(depth_fraction=depth) for depth in (0.0, 1e-3, 0.3, 0.6, 0.8, 0.95)}


def test_shots_on_the_solid_keep_their_energy_at_every_depth(shots):
    assert all(shot.energy_residual <= ENERGY_TOLERANCE for shot in shots.values())


def test_response_changes_smoothly_with_depth(shots):
    """Of the modes: the shots themselves also see at which step a contact opens."""
    depths = (0.3, 0.301, 0.302)
    modes = [find_solid_modes(COARSE, replace(PATCH, depth_fraction=depth)) for depth in depths]
    for sigma in (1e4, 6e4):
        a, b, c = (
            np.sum(m.participation**2 / (m.omega_rad_per_s**2 + sigma**2)) + m.residual_compliance_m_per_n
            for m in modes
        )
        # Going with s^-3, the response changes its slope by ``4 ds / s``, 0.6 % of it.
        assert abs(a - 2.0 * b + c) < 0.01 * abs(b - a)
    change = np.linalg.norm(shots[0.0].force_n - shots[1e-3].force_n)
    assert change < 2e-3 * np.linalg.norm(shots[0.0].force_n)


@pytest.fixture(scope="module")
def one_basis():
    return replace(COARSE, solid=replace(COARSE.solid, one_basis=True))


def test_one_basis_holds_every_depth(one_basis, tmp_path, monkeypatch):
    """Against a plate of each depth alone; in one basis the layers of other depths help to resolve it."""
    plate = CachedSolid(one_basis, PATCH, tmp_path)
    for depth in (0.0, 2e-3, 0.52):
        alone = find_solid_modes(COARSE, replace(PATCH, depth_fraction=depth))
        found = plate.modes(depth)
        for s in (1e4, 1e4 + 6e4j):
            one, other = (
                np.sum(m.participation**2 / (m.omega_rad_per_s**2 + s**2)) + m.residual_compliance_m_per_n
                for m in (found, alone)
            )
            # Quadratics through the thickness leave per milles of the response; the usual mesh 1e-4.
            assert abs(one - other) < 5e-3 * abs(other)
    first = plate.modes(0.52)
    monkeypatch.setattr(plate_models, "build_solid_family", None)  # from here on, only what is kept
    again = CachedSolid(one_basis, PATCH, tmp_path).modes(0.52)
    assert again.omega_rad_per_s.tobytes() == first.omega_rad_per_s.tobytes()
    assert again.participation.tobytes() == first.participation.tobytes()
