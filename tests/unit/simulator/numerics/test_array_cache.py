"""Cached arrays on disk are read back to the last bit, or computed again."""

import json
import logging
import os
import time

import numpy as np
import pytest

from simulator.numerics import array_cache
from simulator.numerics.array_cache import (
    DIGEST_BYTES,
    MAGIC,
    STALE_S,
    compute_cache_key,
    read_arrays,
    read_or_compute_arrays,
    write_arrays,
)

ARRAYS = {
    "cube": np.arange(24.0).reshape(2, 3, 4) / 7.0,
    "scalar": np.array(0.1),
    "special": np.array([np.nan, np.inf, -0.0, 5e-324]),
    "nothing": np.empty((0, 3)),
}


def assert_same_bits(found, expected):
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name].dtype == np.float64
        assert found[name].shape == values.shape
        assert found[name].tobytes() == values.tobytes()


def never():
    raise AssertionError("computed again")


def aged(path, seconds):
    when = time.time() - seconds
    os.utime(path, (when, when))
    return path


def test_kept_arrays_are_read_and_not_computed(tmp_path):
    first = read_or_compute_arrays(tmp_path / "new" / "folder", "key", lambda: ARRAYS)
    assert_same_bits(first, ARRAYS)
    again = read_or_compute_arrays(tmp_path / "new" / "folder", "key", never)
    assert_same_bits(again, ARRAYS)
    again["cube"][0, 0, 0] = 5.0  # the caller may change them


def test_without_a_folder_nothing_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_same_bits(read_or_compute_arrays(None, "key", lambda: ARRAYS), ARRAYS)
    assert list(tmp_path.iterdir()) == []


def test_another_order_in_memory_is_kept_as_the_same_numbers(tmp_path):
    fortran = np.asfortranarray(ARRAYS["cube"])
    computed = read_or_compute_arrays(tmp_path, "key", lambda: {"cube": fortran})
    assert_same_bits(read_or_compute_arrays(tmp_path, "key", never), computed)
    np.testing.assert_array_equal(computed["cube"], ARRAYS["cube"])


@pytest.mark.parametrize(
    "damage",
    [
        lambda stored: stored[: len(stored) // 2],
        lambda stored: b"",
        lambda stored: stored[:-10] + bytes([stored[-10] ^ 1]) + stored[-9:],
        lambda stored: stored[: len(MAGIC)] + bytes(DIGEST_BYTES) + stored[len(MAGIC) + DIGEST_BYTES :],
        lambda stored: b"solimon0" + stored[len(MAGIC) :],
    ],
    ids=["cut", "empty", "one bit", "digest", "another format"],
)
def test_a_damaged_file_is_computed_again_and_repaired(tmp_path, caplog, damage):
    read_or_compute_arrays(tmp_path, "key", lambda: ARRAYS)
    (path,) = tmp_path.iterdir()
    stored = path.read_bytes()
    path.write_bytes(damage(stored))
    with caplog.at_level(logging.WARNING):
        assert_same_bits(read_or_compute_arrays(tmp_path, "key", lambda: ARRAYS), ARRAYS)
    assert "damaged" in caplog.text
    assert path.read_bytes() == stored


def test_a_folder_that_cannot_be_written_does_not_stop_the_work(tmp_path, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    with caplog.at_level(logging.WARNING):
        assert_same_bits(read_or_compute_arrays(blocked, "key", lambda: ARRAYS), ARRAYS)
    assert "going on without" in caplog.text
    assert blocked.read_text() == "not a folder"


def test_a_full_disk_leaves_no_half_file(tmp_path, monkeypatch, caplog):
    def no_space(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(array_cache.Path, "replace", no_space)
    with caplog.at_level(logging.WARNING):
        read_or_compute_arrays(tmp_path, "key", lambda: ARRAYS)
    assert "No space left" in caplog.text
    assert list(tmp_path.iterdir()) == []


def test_a_file_held_open_on_windows_is_skipped_silently(tmp_path, monkeypatch, caplog):
    write_arrays(tmp_path / "key.arrays", ARRAYS)

    def held(*_):
        raise PermissionError(13, "Access is denied")

    monkeypatch.setattr(array_cache.Path, "replace", held)
    with caplog.at_level(logging.INFO):
        write_arrays(tmp_path / "key.arrays", ARRAYS)
    assert caplog.text == ""
    assert [path.name for path in tmp_path.iterdir()] == ["key.arrays"]


def test_the_leftovers_of_a_killed_writer_are_swept_by_the_next_reader(tmp_path):
    read_or_compute_arrays(tmp_path, "key", lambda: ARRAYS)
    names = ("fresh.part", "old.part", "mine.txt")
    for name in names:
        (tmp_path / name).write_bytes(b"half")
    aged(tmp_path / "old.part", 2 * STALE_S)
    aged(tmp_path / "mine.txt", 2 * STALE_S)
    read_or_compute_arrays(tmp_path, "key", never)  # reading is enough
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fresh.part", "key.arrays", "mine.txt"]


def test_a_writer_whose_file_was_swept_goes_on_without(tmp_path, monkeypatch, caplog):
    """A computer that slept through `STALE_S` in the middle of writing."""
    replace = array_cache.Path.replace

    def late(path, target):
        aged(path, 2 * STALE_S)
        read_or_compute_arrays(tmp_path, "other", lambda: ARRAYS) if "slow" in path.name else None
        return replace(path, target)

    monkeypatch.setattr(array_cache.Path, "replace", late)
    with caplog.at_level(logging.WARNING):
        assert_same_bits(read_or_compute_arrays(tmp_path, "slow", lambda: ARRAYS), ARRAYS)
    assert "going on without" in caplog.text
    assert [path.name for path in tmp_path.iterdir()] == ["other.arrays"]


def test_a_folder_grows_to_its_limit_and_loses_its_oldest(tmp_path):
    write_arrays(tmp_path / "a.arrays", ARRAYS)
    size = (tmp_path / "a.arrays").stat().st_size
    for age, name in enumerate(("e", "d", "c", "b")):
        write_arrays(tmp_path / f"{name}.arrays", ARRAYS, limit_bytes=3 * size)
        if (tmp_path / f"{name}.arrays").exists():
            aged(tmp_path / f"{name}.arrays", 100.0 - age)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.arrays", "b.arrays", "c.arrays"]


def test_an_array_larger_than_the_limit_is_still_kept(tmp_path):
    write_arrays(tmp_path / "key.arrays", ARRAYS, limit_bytes=1)
    assert_same_bits(read_or_compute_arrays(tmp_path, "key", never), ARRAYS)


def test_every_input_and_every_source_counts_in_the_key(monkeypatch):
    keys = {
        compute_cache_key({"solid": 1, "depth": 0.5}),
        compute_cache_key({"solid": 1, "depth": np.nextafter(0.5, 1.0)}),
    }
    made_with = array_cache._describe_environment()
    assert compute_cache_key({"depth": 0.5, "solid": 1}) in keys  # the order does not
    for changed in ("code", "libraries", "blas"):
        monkeypatch.setattr(array_cache, "_describe_environment", lambda: made_with | {changed: "another"})  # noqa: B023
        keys.add(compute_cache_key({"solid": 1, "depth": 0.5}))
    assert len(keys) == 5
    assert json.dumps(made_with)


def test_the_file_is_the_one_described(tmp_path):
    write_arrays(tmp_path / "f", {"x": np.array([[1.0, 2.0]])})
    stored = (tmp_path / "f").read_bytes()
    start = len(MAGIC) + DIGEST_BYTES
    end = start + 4 + int.from_bytes(stored[start : start + 4], "little")
    assert end % 64 == 0
    assert json.loads(stored[start + 4 : end]) == [["x", [1, 2]]]
    assert stored[end:] == np.array([1.0, 2.0], dtype="<f8").tobytes()
    assert read_arrays(tmp_path / "absent") is None
