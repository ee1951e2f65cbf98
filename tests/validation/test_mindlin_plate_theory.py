"""The plate element against closed forms: patch tests, no locking, Navier's frequencies and statics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import eigsh, splu

from simulator.materials import bending_stiffness_n_m, plane_modulus_pa, shear_modulus_pa
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.element import SHEAR_CORRECTION
from simulator.plate.mindlin.plate import assemble_plate, build_plate, evaluate_thinning

PAPER = PlateParameters()
PATCH = CorrosionParameters()


def uniform_plate(elements, *, width_m=0.6, height_m=0.6, thickness_m=6e-3, support="simply_supported"):
    plate = PlateParameters(
        width_m=width_m,
        height_m=height_m,
        thickness_m=thickness_m,
        support=support,
        elements_per_edge=8,
        contact_element_m=1e-3,
    )
    x = np.linspace(0.0, width_m / 2, elements // 2 + 1)
    y = np.linspace(0.0, height_m / 2, elements // 2 + 1)
    return plate, assemble_plate(plate, x, y, evaluate_thinning(x, y, PATCH), symmetric=(True, True))


def compliance(plate, depth=0.0):
    stiffness, _ = plate.evaluate_at_depth(depth)
    return float(plate.load @ splu(stiffness).solve(plate.load))


def lowest_frequencies_hz(plate, count):
    stiffness, mass = plate.evaluate_at_depth(0.0)
    eigenvalues = eigsh(stiffness, k=count, M=mass, sigma=0.0, return_eigenvectors=False)
    return np.sqrt(np.sort(eigenvalues)) / (2 * np.pi)


def mindlin_frequency_hz(plate, m, n):
    """Lower root of Mindlin's dispersion relation for ``sin(m pi x / a) sin(n pi y / b)``, hard support.

    ``(kappa G h k^2 - rho h w^2) (D k^2 + kappa G h - rho h^3 w^2 / 12) = (kappa G h k)^2``
    (Mindlin 1951, doi:10.1115/1.4010217).
    """
    h, rho = plate.thickness_m, plate.density_kg_per_m3
    k2 = (m * np.pi / plate.width_m) ** 2 + (n * np.pi / plate.height_m) ** 2
    shear = SHEAR_CORRECTION * h * shear_modulus_pa(plate.youngs_modulus_pa, plate.poisson_ratio)
    bending = bending_stiffness_n_m(plate.youngs_modulus_pa, plate.poisson_ratio, h)
    mass, inertia = rho * h, rho * h**3 / 12
    roots = np.roots(
        [mass * inertia, -(shear * k2 * inertia + mass * (bending * k2 + shear)), shear * k2 * bending * k2]
    )
    return float(np.sqrt(roots.real.min()) / (2 * np.pi))


def nodal_field(plate, w, beta_x, beta_y):
    x, y = np.meshgrid(plate.x_m, plate.y_m, indexing="ij")
    values = np.stack((w(x, y), beta_x(x, y), beta_y(x, y)), axis=2)
    return values.ravel()[plate.free]


def inner_unknowns(plate):
    """Free unknowns of nodes that no element connects with the held edge."""
    number = np.arange(3 * len(plate.x_m) * len(plate.y_m)).reshape(len(plate.x_m), len(plate.y_m), 3)
    inside = np.zeros(number.shape, dtype=bool)
    inside[2:-2, 2:-2] = True
    return inside.ravel()[plate.free]


@pytest.mark.parametrize(
    ("w", "beta_x", "beta_y"),
    [
        # Constant curvatures without shear: beta = -grad w.
        (lambda x, y: x**2 / 2, lambda x, y: -x, lambda x, y: 0 * x),
        (lambda x, y: y**2 / 2, lambda x, y: 0 * x, lambda x, y: -y),
        (lambda x, y: x * y, lambda x, y: -y, lambda x, y: -x),
        # A rigid body. (Constant shear needs a moment that grows: no state of constant strain.)
        (lambda x, y: x - 2 * y + 3, lambda x, y: -1 + 0 * x, lambda x, y: 2 + 0 * x),
    ],
    ids=["bend x", "bend y", "twist", "rigid"],
)
def test_patch_test_on_a_graded_mesh(w, beta_x, beta_y):
    """A state of constant strain is in equilibrium at every inner node, for any element sizes."""
    parameters = replace(PAPER, elements_per_edge=16, contact_element_m=1e-3)
    plate = build_plate(parameters, PATCH, whole=True)
    stiffness, _ = plate.evaluate_at_depth(0.0)
    field = nodal_field(plate, w, beta_x, beta_y)
    inner = inner_unknowns(plate)
    forces = stiffness @ field
    # Rounding of each row: its terms cancel to machine precision of their absolute sum.
    size = abs(stiffness) @ np.abs(field) + abs(stiffness).max() * 1e-12
    assert inner.sum() > 300
    assert np.all(np.abs(forces[inner]) <= 1e-13 * size[inner])


@pytest.mark.parametrize(
    ("support", "kirchhoff"),
    [("simply_supported", 0.0116008), ("clamped", 0.0056121)],
    ids=["simple", "clamped"],
)
def test_coarse_elements_do_not_lock_however_thin(support, kirchhoff):
    """Centre deflection of thin square plates, ``w = c F a^2 / D`` (Timoshenko, articles 34 and 44)."""
    values = []
    for slenderness in (1e2, 1e3, 1e4, 1e5):
        parameters, plate = uniform_plate(16, thickness_m=0.6 / slenderness, support=support)
        bending = bending_stiffness_n_m(parameters.youngs_modulus_pa, 0.3, parameters.thickness_m)
        values.append(compliance(plate) * bending / 0.6**2)
    # 16 bilinear elements along an edge: discretisation of 1 %; the shear of a/h = 100 adds another.
    assert np.all(np.abs(np.array(values) / kirchhoff - 1.0) < 0.02)
    assert values[-1] == pytest.approx(values[-2], rel=1e-3)  # a locking element would drop by 100


def test_coarse_elements_near_the_contact_do_not_lock():
    """Elements three times as large as the thickness around a fine contact cost per cent, not factors."""
    fine = compliance(build_plate(PAPER, PATCH))
    coarse = compliance(build_plate(replace(PAPER, elements_per_edge=24, contact_element_m=1e-4), PATCH))
    assert coarse == pytest.approx(fine, rel=0.02)


def test_frequencies_converge_to_mindlins_with_order_two():
    modes = [(1, 1), (1, 3), (3, 1), (3, 3)]
    for width, height in ((0.6, 0.6), (0.5, 0.8)):
        errors = []
        for elements in (16, 32, 64):
            parameters, plate = uniform_plate(elements, width_m=width, height_m=height)
            exact = np.sort([mindlin_frequency_hz(parameters, m, n) for m, n in modes])
            found = lowest_frequencies_hz(plate, 6)
            nearest = [found[np.argmin(np.abs(found - f))] for f in exact]
            errors.append(np.max(np.abs(np.array(nearest) / exact - 1.0)))
        assert errors[-1] < 3e-3
        orders = np.log2(np.array(errors[:-1]) / errors[1:])
        assert np.all((orders > 1.9) & (orders < 2.1))  # bilinear elements: h^2


def test_distributed_load_compliance_converges_with_order_two():
    """Navier's series for a uniform pressure, Mindlin: each term ``1/(D k^4) + 1/(kappa G h k^2)``."""
    parameters, _ = uniform_plate(8)
    a, h = parameters.width_m, parameters.thickness_m
    bending = bending_stiffness_n_m(parameters.youngs_modulus_pa, 0.3, h)
    shear = SHEAR_CORRECTION * h * shear_modulus_pa(parameters.youngs_modulus_pa, 0.3)
    odd = np.arange(1, 400, 2)
    m, n = np.meshgrid(odd, odd)
    k2 = (m**2 + n**2) * (np.pi / a) ** 2
    sign = (-1.0) ** ((m - 1) // 2 + (n - 1) // 2)
    exact = np.sum(16 / (np.pi**2 * m * n) * sign * (1 / (bending * k2**2) + 1 / (shear * k2)))
    errors = []
    for elements in (16, 32, 64):
        _, plate = uniform_plate(elements)
        stiffness, mass = plate.evaluate_at_depth(0.0)
        deflection = np.zeros(3 * len(plate.x_m) * len(plate.y_m))
        deflection[::3] = 1.0
        # The consistent mass turns a unit acceleration into rho h times a unit pressure; held nodes
        # take their share with them, an error of order h^2 like the rest.
        pressure = (mass @ deflection[plate.free]) / (parameters.density_kg_per_m3 * h)
        errors.append(abs(plate.load @ splu(stiffness).solve(pressure) / exact - 1.0))
    assert errors[-1] < 2e-3
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 1.7) & (orders < 2.3))


def test_shear_modulus_has_the_two_that_equation_5_lacks():
    assert shear_modulus_pa(200e9, 0.3) == pytest.approx(76.923e9, rel=1e-5)
    assert plane_modulus_pa(200e9, 0.3) == pytest.approx(219.78e9, rel=1e-5)
