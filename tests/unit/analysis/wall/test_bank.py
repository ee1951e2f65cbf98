"""Bank of wall curves: its conditions and its file."""

import io
from dataclasses import fields, replace

import numpy as np
import pytest

from analysis.errors import InvalidInputError
from analysis.wall.bank import FEATURES, Bank, load_bank, save_bank

LOSSES = np.linspace(0.0, 0.8, 17)


@pytest.fixture
def bank():
    changes = np.multiply.outer([1.0, 2.0], np.multiply.outer(LOSSES, np.arange(5.0)))
    changes[1, 9:] = np.nan
    return Bank(
        losses=LOSSES,
        changes=changes,
        models=("solid", "mindlin"),
        kinds=("solid", "bowl"),
        sizes_m=np.array([25.4e-3, 50.8e-3]),
        names=("solid, 25.4 mm", "bowl, 50.8 mm"),
        sound=np.arange(-5.0, 0.0),
        slopes=np.arange(10.0).reshape(2, 5) / 3.0,
        sources=("gain", "tilt_rad"),
        thickness_m=6.35e-3,
        digest="0123abcd",
    )


@pytest.fixture
def content(bank):
    file = io.BytesIO()
    save_bank(bank, file)
    return file.getvalue()


def test_a_stored_bank_is_the_same_to_single_precision(bank, tmp_path):
    file = tmp_path / "bank.npz"
    save_bank(bank, file)
    found = load_bank(file)
    assert len(FEATURES) == found.changes.shape[2]
    for field in fields(Bank):
        was, now = getattr(bank, field.name), getattr(found, field.name)
        if isinstance(was, np.ndarray):
            assert now.dtype == np.float64
            assert not now.flags.writeable
            np.testing.assert_allclose(now, was, rtol=6e-8)  # half a unit in the last place of float32
        else:
            assert now == was
    np.testing.assert_array_equal(found.losses, bank.losses)


@pytest.mark.parametrize("kept", [0, 1, 30, 0.5, 0.99])
def test_a_truncated_file_is_named_with_the_remedy(content, kept, tmp_path):
    file = tmp_path / "bank.npz"
    file.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    with pytest.raises(InvalidInputError, match=r"bank\.npz is no intact wall bank .*Delete it"):
        load_bank(file)


def test_a_flipped_byte_is_found_in_the_data_and_never_another_error(content):
    start = content.index(b"changes.npy") + 100
    found = 0
    for place in [*range(start, start + 60), *range(len(content) - 300, len(content))]:
        damaged = bytearray(content)
        damaged[place] ^= 0xFF
        try:
            load_bank(io.BytesIO(damaged))
        except InvalidInputError:
            found += 1
        else:
            assert place >= start + 60, "a date in the directory, or the like"
    assert found > 100


@pytest.mark.parametrize(
    "change",
    [
        {"format": np.asarray("solimon wall bank 0")},
        {"losses": None},
        {"more": np.zeros(1)},
        {"losses": np.zeros(3)},
        {"sizes_m": np.asarray(["large", "small"])},
    ],
    ids=str,
)
def test_a_foreign_or_incomplete_file_is_refused(content, change):
    arrays = dict(np.load(io.BytesIO(content))) | change
    file = io.BytesIO()
    np.savez(file, **{name: values for name, values in arrays.items() if values is not None})
    file.seek(0)
    with pytest.raises(InvalidInputError, match="no intact wall bank"):
        load_bank(file)


def test_an_absent_file_is_an_error_of_its_own(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_bank(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"changes": np.zeros((2, 17, 4))}, r"changes .*\(2, 17, 4\); \(2, 17, 5\)"),
        ({"slopes": np.zeros((1, 5))}, r"slopes .*\(1, 5\); \(2, 5\)"),
        ({"slopes": np.full((2, 5), np.nan)}, "slopes finite"),
        ({"losses": np.minimum(LOSSES, 0.5)}, "start with 0 and increase"),
        ({"losses": LOSSES + 0.01}, "start with 0 and increase"),
        ({"changes": np.ones((2, 17, 5))}, "0 at loss 0"),
        ({"kinds": ("solid",)}, "1 kinds and 2 names"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(bank, change, match):
    with pytest.raises(InvalidInputError, match=match):
        replace(bank, **change)
