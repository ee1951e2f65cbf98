"""Clamped and free plates against the literature: square thin plates, nu = 0.3.

Dimensionless frequencies ``lambda = omega a^2 sqrt(rho h / D)``: Leissa 1973, The free vibration of
rectangular plates, doi:10.1016/S0022-460X(73)80371-2; for free edges the converged Ritz values, which lie
up to 0.5 % below those of 1973.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import eigsh

from simulator.materials import bending_stiffness_n_m
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses

THIN = PlateParameters(thickness_m=1e-3, suspension_hz=1.0)
PATCH = CorrosionParameters(size_m=0.3048)


def dimensionless(plate, count, *, elements, whole, rigid=0):
    """Eigenvalues of an almost even mesh, those of the bed taken off."""
    meshed = replace(plate, elements_per_edge=elements, contact_element_m=0.8 * plate.width_m / elements)
    parts = build_plate(meshed, PATCH, whole=whole)
    stiffness, mass = parts.evaluate_at_depth(0.0)
    values = np.sort(eigsh(stiffness, k=count + rigid, M=mass, sigma=-1.0, return_eigenvectors=False))
    if plate.support == "free":
        values -= (2 * np.pi * plate.suspension_hz) ** 2
        # The bed pushes at the deflection alone, and a rocking plate turns: its rotary inertia is 1e-6.
        assert np.all(np.abs(values[:rigid]) < 1e-5 * (2 * np.pi * plate.suspension_hz) ** 2)
    bending = bending_stiffness_n_m(plate.youngs_modulus_pa, plate.poisson_ratio, plate.thickness_m)
    mass_per_area = plate.density_kg_per_m3 * plate.thickness_m
    return np.sqrt(values[rigid:] * mass_per_area / bending) * plate.width_m**2


@pytest.mark.parametrize(
    ("support", "whole", "expected"),
    [
        ("free", True, (13.468, 19.596, 24.270, 34.801, 34.801)),
        ("free", False, (19.596, 24.270)),  # what a load in the middle reaches
        ("clamped", True, (35.985, 73.394, 73.394, 108.22)),
        ("clamped", False, (35.985, 131.58)),
        ("simply_supported", True, (19.739, 49.348, 49.348, 78.957)),
    ],
)
def test_thin_square_plates_have_the_frequencies_of_the_literature(support, whole, expected):
    plate = replace(THIN, support=support)
    rigid = 0 if support != "free" else (3 if whole else 1)
    errors = []
    for elements in (20, 40):
        found = dimensionless(plate, len(expected), elements=elements, whole=whole, rigid=rigid)
        errors.append(np.max(np.abs(found / expected - 1.0)))
    # Bilinear elements: order two; what is left with 40 along an edge, most in the shortest waves.
    assert errors[1] < 1e-2
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.3)


def test_bed_carries_the_static_load_and_adds_its_frequency_to_every_mode():
    plate = replace(THIN, support="free", elements_per_edge=16, contact_element_m=5e-3)
    for suspension_hz in (1.0, 10.0):
        parts = build_plate(replace(plate, suspension_hz=suspension_hz), PATCH)
        stiffness, _ = parts.evaluate_at_depth(0.0)
        heave = np.zeros(3 * len(parts.x_m) * len(parts.y_m))
        heave[::3] = 1.0
        heave = heave[parts.free]
        weight_kg = plate.density_kg_per_m3 * plate.thickness_m * plate.width_m * plate.height_m
        # A rigid motion strains nothing: all that resists is the bed.
        expected = weight_kg * (2 * np.pi * suspension_hz) ** 2
        # What large stiffnesses leave of a motion without strain is rounding, a little of each entry.
        rounding = np.finfo(float).eps * (heave @ (abs(stiffness) @ heave))
        assert heave @ (stiffness @ heave) == pytest.approx(expected, rel=1e-12, abs=rounding)


def test_shot_does_not_feel_the_edges_nor_the_suspension(reduction_folder):
    """Bending waves come back from the edge after the reflected wave has left, but for forerunners."""
    found = {}
    for name, changes in {
        "simple": {},
        "clamped": {"support": "clamped"},
        "free": {"support": "free"},
        "softer": {"support": "free", "suspension_hz": 2.0},
    }.items():
        plate = PlateParameters(elements_per_edge=32, contact_element_m=1e-3, **changes)
        model = ShotModel(
            ChainParameters(), plate, CorrosionParameters(), cache_folder=reduction_folder, duration_s=1.2e-3
        )
        found[name] = model.shot()
        assert found[name].energy_residual <= 1e-5  # a tenth of what is demanded
    reference = found["simple"]
    psw = reference.time_s < 0.6e-3
    for name in ("clamped", "free"):
        difference = found[name].force_n - reference.force_n
        # Measured: 2e-4 and 4e-6 up to the end of the reflected wave, 3e-2 and 2e-2 in the whole record.
        assert np.linalg.norm(difference[psw]) <= 5e-4 * np.linalg.norm(reference.force_n[psw])
        assert np.linalg.norm(difference) >= 5e-3 * np.linalg.norm(reference.force_n)
        assert summarise_pulses(found[name]).tof_us == pytest.approx(
            summarise_pulses(reference).tof_us, abs=0.01
        )
    softer = found["softer"].force_n - found["free"].force_n
    assert np.linalg.norm(softer) <= 1e-4 * np.linalg.norm(reference.force_n)
