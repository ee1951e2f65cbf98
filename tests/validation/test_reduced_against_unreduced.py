"""The reduced plate's shot against all unknowns of the same mesh, integrated by another method.

`benchmarks/reduced_against_unreduced.py` does so on the paper's mesh; the default here is a coarser one.
The reference is the trapezoidal rule for chain and every unknown, extrapolated from two steps, with its
order observed from three. Whole plate and quarter, both sensors, square and round patches.
"""

import itertools

import numpy as np
import pytest
from support.benchmark_modules import benchmark_module

from simulator.chain.spheres import build_chain
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate
from simulator.shot.model import ShotModel

COARSE = PlateParameters(elements_per_edge=16, contact_element_m=2e-3)
ALLOWED = 1e-4
STEPS_S = (5e-7, 2.5e-7, 1.25e-7)


@pytest.fixture(scope="module")
def benchmark():
    return benchmark_module("reduced_against_unreduced")


def unreduced(benchmark, chain, plate, patch, depth, *, whole=False):
    """Extrapolated force, and the observed order in time."""
    parts = build_plate(plate, patch, whole=whole)
    forces = [benchmark.unreduced_force(build_chain(chain, plate), parts, depth, h) for h in STEPS_S]
    changes = [np.linalg.norm(b - a) for a, b in itertools.pairwise(forces)]
    return forces[-1] + (forces[-1] - forces[-2]) / 3.0, np.log2(changes[0] / changes[1])


def difference(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize(
    ("sensor", "shape", "size_m", "depth"),
    [
        ("sphere", "round", 50.8e-3, 0.8),
        ("sphere", "square", 25.4e-3, 0.1),
        pytest.param("disk", "square", 50.8e-3, 0.0, marks=pytest.mark.slow),
        pytest.param("disk", "square", 50.8e-3, 0.8, marks=pytest.mark.slow),
        pytest.param("sphere", "round", 50.8e-3, 0.45, marks=pytest.mark.slow),
        pytest.param("sphere", "square", 25.4e-3, 0.93, marks=pytest.mark.slow),
    ],
)
def test_reduced_shot_is_that_of_all_unknowns(benchmark, reduction_folder, sensor, shape, size_m, depth):
    chain, patch = ChainParameters(sensor=sensor), CorrosionParameters(shape=shape, size_m=size_m)
    expected, order = unreduced(benchmark, chain, COARSE, patch, depth)
    # Two between events and at their kinks; the steps are coarse enough to see that, and fine enough.
    assert order == pytest.approx(2.0, abs=0.25)
    model = ShotModel(chain, COARSE, patch, duration_s=benchmark.RECORD_S, cache_folder=reduction_folder)
    shot = model.shot(depth_fraction=depth)
    every = round(benchmark.SAMPLE_S / (shot.time_s[1] - shot.time_s[0]))
    assert difference(shot.force_n[::every], expected) <= ALLOWED


@pytest.mark.slow
@pytest.mark.parametrize("size_m", [25.4e-3, 50.8e-3])
@pytest.mark.parametrize("depth", [0.0, 0.4, 0.95])
def test_reduced_shot_on_the_papers_mesh(benchmark, size_m, depth):
    found = benchmark.compare(size_m, depth, (5e-7, 2.5e-7, 1.25e-7))
    assert found.difference_l2 <= ALLOWED
