"""A set file with external links or wrong sizes is rejected before any data are read."""

import re
import sys
import tracemalloc

import h5py
import numpy as np
import pytest
from h5py import h5d, h5p, h5s, h5t, h5z
from support.archived_sets import make_set

from daq_service.archive import CorruptArchiveError
from daq_service.archive.consolidated import list_record_blocks
from daq_service.archive.layout import build_set_image
from daq_service.archive.reader import read_set_file
from daq_service.archive.verification import check_set_file
from daq_service.cli.offline.record_file import FileParameters, open_records
from daq_service.errors import UsageError

COLUMN = "shots/utc_ns"
LARGE = 4_000_000_000


def _external_storage(entry, secret):
    size = entry[COLUMN].size
    del entry[COLUMN]
    entry.create_dataset(COLUMN, (size,), "<i8", external=[(str(secret), 0, 8 * size)])


def _external_link(entry, secret):
    entry["shots/more"] = h5py.ExternalLink(str(secret), "/entry")


def _soft_link(entry, _):
    entry["shots/more"] = h5py.SoftLink("/entry/shots/utc_ns")


def _virtual(entry, secret):
    layout = h5py.VirtualLayout((4,), "<i8")
    layout[:] = h5py.VirtualSource(str(secret), "entry/shots/utc_ns", (4,), "<i8")
    entry.create_virtual_dataset("shots/more", layout)


def _cycle(entry, _):
    entry["shots/more"] = entry


def _deep(entry, _):
    entry.create_group("/".join("g" * 50))


def _named_type(entry, _):
    entry["more"] = np.dtype("<i8")


def _plug_in(entry, _):
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_chunk((4,))
    properties.set_filter(32001, h5z.FLAG_OPTIONAL, ())
    h5d.create(entry.id, b"more", h5t.STD_I64LE, h5s.create_simple((4,)), dcpl=properties)


def _twice_deflated(entry, _):
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_chunk((4,))
    properties.set_deflate(9)
    properties.set_deflate(9)
    h5d.create(entry.id, b"more", h5t.STD_I64LE, h5s.create_simple((4,)), dcpl=properties)


def _variable_texts(entry, _):
    entry.create_dataset("more", data=["x"] * 4, dtype=h5py.string_dtype(), chunks=(4,))


def _one_long_text(entry, _):
    entry.attrs["more"] = "x" * 100_000


def _compound(entry, _):
    entry.create_dataset("more", data=np.zeros(4, "<i8,<f8"), chunks=(4,))


def _claimed_record(entry, _):
    del entry["B_waveforms/waveform"]
    entry.create_dataset("B_waveforms/waveform", (4, LARGE), "<i2", chunks=(1, 300), compression="gzip")


def _claimed_column(entry, _):
    del entry[COLUMN]
    entry.create_dataset(COLUMN, (LARGE,), "<i8", chunks=(1024,), compression="gzip")


def _claimed_plainly(entry, _):
    del entry[COLUMN]
    entry.create_dataset(COLUMN, (LARGE,), "<i8")


def _empty_rows(entry, _):
    del entry[COLUMN]
    entry.create_dataset(COLUMN, (LARGE, 0), "<i8")


def _inflated_column(entry, _):
    """Return forty million equal numbers in 311 kB: deflate can explain them, the records cannot."""
    del entry[COLUMN]
    n = 1_000_000
    entry.create_dataset(COLUMN, data=np.zeros(n, "<i8"), chunks=(n,), compression="gzip")


REFUSED = {
    _external_storage: "in other files",
    _external_link: "link to elsewhere",
    _soft_link: "link to elsewhere",
    _virtual: "in other files",
    _cycle: "a circle of groups",
    _deep: "deeper than",
    _named_type: "is a type",
    _plug_in: "has filters",
    _twice_deflated: "has filters",
    _variable_texts: "a type that no set has",
    _one_long_text: "heap of strings",
    _compound: "a type that no set has",
    _claimed_record: "claims",
    _claimed_column: "claims",
    _claimed_plainly: "claims",
    _empty_rows: "explain",
    _inflated_column: "explain",
}


@pytest.fixture
def path(tmp_path):
    (tmp_path / "set.h5").write_bytes(build_set_image(make_set()))
    (tmp_path / "secret").write_bytes(build_set_image(make_set()))
    return tmp_path / "set.h5"


@pytest.mark.parametrize("change", REFUSED, ids=lambda change: change.__name__[1:])
def test_external_links_and_wrong_sizes_are_rejected(path, change):
    with h5py.File(path, "r+") as file:
        change(file["entry"], path.with_name("secret"))
    pattern = re.compile(REFUSED[change])
    tracemalloc.start()
    with pytest.raises(CorruptArchiveError, match=pattern):
        read_set_file(path, skip_damaged=True)
    with pytest.raises(CorruptArchiveError, match=pattern):
        list_record_blocks(path.parent, path.name)
    with pytest.raises(UsageError, match=pattern):
        open_records(path, FileParameters())
    assert any(pattern.search(str(damage)) for damage in check_set_file(path).damages)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # A few copies of the file and its handles: far below what it claims.
    assert peak < 10 * path.stat().st_size + 5_000_000


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there that few users have")
def test_a_link_in_a_data_folder_is_rejected(path):
    link = path.with_name("link.h5")
    link.symlink_to(path)
    with pytest.raises(CorruptArchiveError, match="it is a link"):
        read_set_file(link)
    assert "it is a link" in str(check_set_file(link).damages[0])
    # A link as an argument of a command means the linked file.
    assert open_records(link, FileParameters()).n == len(make_set().shots)


def test_a_file_too_large_for_memory_is_not_read(path):
    with path.open("r+b") as file:
        file.truncate(2**40)  # a hole
    with pytest.raises(CorruptArchiveError, match="too large"):
        read_set_file(path)
    with pytest.raises(UsageError, match="too large"):
        open_records(path, FileParameters())
