"""A small file that declares a large table or a pickle is rejected before memory is allocated."""

import struct
import tracemalloc

import pytest

from daq_service.cli.offline import table_file
from daq_service.cli.offline.record_file import FileParameters, open_records
from daq_service.cli.offline.table_file import read_table
from daq_service.errors import UsageError


def _npy(path, shape, kind):
    header = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(80))


@pytest.mark.parametrize(
    ("shape", "kind"),
    [((8, 10**9), "<f8"), ((2**40, 2**40), "<f8"), ((2**70, 2), "<f8"), ((10, 1), "|O"), ((-1, 4), "<f8")],
    ids=str,
)
def test_an_array_larger_than_its_file_or_a_pickle_is_refused(tmp_path, shape, kind):
    path = tmp_path / "small.npy"
    _npy(path, shape, kind)
    tracemalloc.start()
    with pytest.raises(UsageError, match=r"not a \.npy file"):
        open_records(path, FileParameters())
    with pytest.raises(UsageError, match=r"not a \.npy file"):
        read_table(path, features=(), baseline_rows=1, baseline_where=None)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5_000_000  # a file of 208 bytes


def test_a_parquet_table_is_refused_by_what_its_header_claims(tmp_path, monkeypatch):
    arrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = tmp_path / "table.parquet"
    parquet.write_table(arrow.table({name: [1.0] * 40 for name in "abc"}), path)
    monkeypatch.setattr(table_file, "MOST_CELLS", 119)
    monkeypatch.setattr(parquet.ParquetFile, "read", lambda _: pytest.fail("the values are read"))
    with pytest.raises(UsageError, match="40 rows of 3 columns"):
        read_table(path, features=(), baseline_rows=1, baseline_where=None)
