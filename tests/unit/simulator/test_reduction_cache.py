"""The cache changes how long a reduction takes, nothing else."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from simulator import reduction_cache
from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.reduction_cache import DIGEST_BYTES, reduced_plate, reduction_key

PLATE = PlateParameters(elements_per_edge=16, contact_element_m=2e-3)
PATCH = CorrosionParameters()


def assert_same_bits(one, other):
    for name in ("stiffness", "mass", "load"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), strict=True)


def the_only_file(folder):
    (path,) = folder.iterdir()
    return path


@pytest.fixture
def counted(monkeypatch):
    calls = []
    compute = reduction_cache.plate_reduction.reduce_plate

    def counting(plate):
        calls.append(plate)
        return compute(plate)

    monkeypatch.setattr(reduction_cache.plate_reduction, "reduce_plate", counting)
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


@pytest.mark.parametrize(
    "damage",
    [
        lambda stored: stored[: len(stored) // 2],
        lambda stored: b"",
        lambda stored: stored[:-100] + bytes([stored[-100] ^ 1]) + stored[-99:],
        lambda stored: bytes(DIGEST_BYTES) + stored[DIGEST_BYTES:],
    ],
    ids=["cut", "empty", "one bit", "digest"],
)
def test_a_damaged_file_is_computed_again_and_repaired(tmp_path, counted, caplog, damage):
    good = reduced_plate(PLATE, PATCH, tmp_path)
    path = the_only_file(tmp_path)
    stored = path.read_bytes()
    path.write_bytes(damage(stored))
    with caplog.at_level(logging.WARNING):
        assert_same_bits(reduced_plate(PLATE, PATCH, tmp_path), good)
    assert "damaged" in caplog.text
    assert path.read_bytes() == stored
    assert len(counted) == 2


def test_a_folder_that_cannot_be_written_does_not_stop_the_work(tmp_path, counted, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    with caplog.at_level(logging.WARNING):
        reduction = reduced_plate(PLATE, PATCH, blocked)
    assert "going on without" in caplog.text
    assert_same_bits(reduction, reduced_plate(PLATE, PATCH, None))
    assert blocked.read_text() == "not a folder"


def test_a_full_disk_leaves_no_half_file(tmp_path, monkeypatch, caplog):
    def no_space(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(reduction_cache.Path, "replace", no_space)
    with caplog.at_level(logging.WARNING):
        reduced_plate(PLATE, PATCH, tmp_path)
    assert "No space left" in caplog.text
    assert list(tmp_path.iterdir()) == []
