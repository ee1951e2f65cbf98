"""The cache changes how long a reduction takes, nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin import cache
from simulator.plate.mindlin.cache import reduced_plate, reduction_key

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
    uncached = reduced_plate(PLATE, PATCH, None)
    first = reduced_plate(PLATE, PATCH, tmp_path)
    again = reduced_plate(PLATE, PATCH, tmp_path)
    assert len(counted) == 2
    assert_same_bits(uncached, first)
    assert_same_bits(first, again)


def test_depth_shares_a_reduction_and_everything_else_does_not():
    key = reduction_key(PLATE, PATCH)
    assert key == reduction_key(PLATE, replace(PATCH, depth_fraction=0.5))
    others = [
        reduction_key(PLATE, replace(PATCH, size_m=0.03)),
        reduction_key(PLATE, replace(PATCH, shape="round")),
        reduction_key(replace(PLATE, support="clamped"), PATCH),
        reduction_key(replace(PLATE, thickness_m=6e-3), PATCH),
    ]
    assert len({key, *others}) == 5
