"""The cache changes how long a reduction takes, nothing else."""

import numpy as np
import pytest

from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin import cache
from simulator.plate.mindlin.cache import load_reduced_plate

PLATE = PlateParameters(elements_per_edge=16, contact_element_m=2e-3)
PATCH = CorrosionParameters()


def assert_same_bits(one, other):
    for name in ("stiffness", "mass", "load"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), strict=True)


@pytest.fixture
def counted(monkeypatch):
    calls = []
    compute = cache.reduce_plate

    def counting(plate):
        calls.append(plate)
        return compute(plate)

    monkeypatch.setattr(cache, "reduce_plate", counting)
    return calls


def test_cached_equals_uncached_bit_for_bit(tmp_path, counted):
    uncached = load_reduced_plate(PLATE, PATCH, None)
    first = load_reduced_plate(PLATE, PATCH, tmp_path)
    again = load_reduced_plate(PLATE, PATCH, tmp_path)
    assert len(counted) == 2
    assert_same_bits(uncached, first)
    assert_same_bits(first, again)
