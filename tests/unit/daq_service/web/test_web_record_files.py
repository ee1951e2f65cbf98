"""Records exported in slices read back equal in pandas, pyarrow, numpy, scipy, h5py and silx."""

import io
import json

import h5py
import numpy as np
import pandas as pd
import pyarrow
import pytest
import silx.io
import silx.io.nxdata
from pyarrow import parquet
from scipy.io import loadmat
from support.filled_folder import filled_folder
from support.served_web import served

from daq_service import client
from daq_service.web.routes import tables
from daq_service.web.tables import records
from daq_service.web.tables.formats import FORMATS

SHOTS = 3
STORED = (1, 2, 4)


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), shots_per_set=SHOTS) as folder:
        for index in range(6):
            folder.add_set(index, stored=index in STORED)
        yield folder


def exported(api, position, form, **query):
    answer = api.get(f"/api/v1/waveforms/{position}", params={"format": form, **query})
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].partition(";")[0] == FORMATS[form].media_type
    return answer.content


def read_npz(content):
    with np.load(io.BytesIO(content)) as arrays:
        return dict(arrays)


def test_every_format_has_the_records_and_their_metadata(api, filled, service):
    query = {"from_h": 1.0, "to_h": 2.0}
    with client.open(service.url) as test:
        waves = test.waveforms("B", from_h=1.0, to_h=2.0)
    taken = [record for index in (1, 2) for record in filled.records(index) if record.key.position == "B"]
    volts = np.stack([record.waveform.volts() for record in taken])
    time_s = taken[0].waveform.time_s()
    np.testing.assert_array_equal(waves, volts)
    facts = {
        **{name: waves[name].values.tolist() for name in ("set_index", "shot_index", "sequence", "due_h")},
        "quality": ["good"] * len(taken),
        "flags": [""] * len(taken),
        "readable": [True] * len(taken),
        "sample_rate_hz": [taken[0].waveform.sample_rate_hz] * len(taken),
    }

    csv = pd.read_csv(io.BytesIO(exported(api, "B", "csv", **query)))
    names = [f"set_{record.key.set_index}_shot_{record.key.shot_index}_good_v" for record in taken]
    assert list(csv) == ["time_s", *names]
    np.testing.assert_array_equal(csv.to_numpy().T, [time_s, *volts], err_msg="to the last bit")

    for table in (
        parquet.read_table(io.BytesIO(exported(api, "B", "parquet", **query))),
        pyarrow.ipc.open_stream(exported(api, "B", "arrow", **query)).read_all(),
    ):
        np.testing.assert_array_equal(np.stack(table["voltage_v"].to_pandas().to_numpy()), volts)
        for name, values in facts.items():
            assert table[name].to_pylist() == values, name
        assert (table["utc"].to_pandas().astype("int64") == [r.stamp.utc_ns for r in taken]).all()
        assert table.schema.field("voltage_v").metadata == {b"unit": b"V"}
        assert json.loads(table.schema.metadata[b"solimon"])["n_unreadable"] == 0

    arrays = read_npz(exported(api, "B", "npz", **query))
    struct = loadmat(io.BytesIO(exported(api, "B", "mat", **query)), squeeze_me=True)["waveforms"]
    with h5py.File(io.BytesIO(exported(api, "B", "h5", **query))) as file:
        group = file[file.attrs["default"]][file["entry"].attrs["default"]]
        assert (group.attrs["signal"], [*group.attrs["axes"]]) == ("voltage_v", ["sequence", "time_s"])
        assert (group["voltage_v"].attrs["units"], group["time_s"].attrs["units"]) == ("V", "s")
        ways = [arrays, {name: struct[name].item() for name in struct.dtype.names}]
        ways.append({name: group[name][()] for name in group})
    for found in ways:
        np.testing.assert_array_equal(found["voltage_v"], volts)
        np.testing.assert_array_equal(found["time_s"], time_s)
        for name, values in facts.items():
            if isinstance(values[0], str):
                texts = [v.decode() if isinstance(v, bytes) else v for v in found[name]]
                assert [text if isinstance(text, str) else "" for text in texts] == values, name
            else:
                np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_viewers_plot_the_records_over_time(api, tmp_path):
    path = tmp_path / "records.h5"
    for position, n_records in (("B", SHOTS), ("A", 1)):
        path.write_bytes(exported(api, position, "h5", first_set=4, last_set=4))
        with silx.io.open(str(path)) as file:
            shown = silx.io.nxdata.get_default(file)
            assert (shown.signal_name, shown.axes_names) == ("voltage_v (V)", ["sequence", "time_s (s)"])
            assert shown.signal.shape[0] == n_records
            assert not shown.issues


def test_sets_or_hours_are_chosen(api):
    for query, sets in (
        ({"first_set": 2}, [2, 4]),
        ({"first_set": 2, "to_h": 2.0}, [2]),
        ({}, [1, 2, 4]),
        ({"from_h": 1.5, "last_set": 4}, [2, 4]),
    ):
        found = read_npz(exported(api, "C", "npz", **query))
        assert found["set_index"].tolist() == [index for index in sets for _ in range(SHOTS)]
    answer = api.get("/api/v1/waveforms/C?first_set=1&last_set=1&format=npz")
    assert 'filename="waveforms_C_000001.npz"' in answer.headers["content-disposition"]


@pytest.mark.parametrize(
    ("query", "status", "message"),
    [
        ("X", 404, "The positions are A, B, C, D"),
        ("B?first_set=3&last_set=3", 404, "is stored in these sets"),
        ("B?from_h=100", 404, "no record of position B is stored"),
        ("B?from_h=2&to_h=1", 422, "ends at 1, before 2"),
        ("B?first_set=2&last_set=1", 422, "ends at 1, before 2"),
        ("B?format=xlsx", 422, "csv"),
        ("B?last_set=-1", 422, "last_set"),
    ],
)
def test_an_impossible_export_is_rejected_with_its_reason(api, query, status, message):
    answer = api.get(f"/api/v1/waveforms/{query}")
    assert answer.status_code == status
    assert message in answer.text


def test_a_too_large_export_is_rejected_with_limit_and_remedy(api, filled, monkeypatch):
    record, *_ = [r for r in filled.records(1) if r.key.position == "B" and r.key.shot_index == 0]
    one_set = 8 * SHOTS * record.waveform.counts.size
    monkeypatch.setattr(tables, "MOST_RECORD_BYTES", one_set)
    assert exported(api, "B", "npz", first_set=1, last_set=1)
    answer = api.get("/api/v1/waveforms/B?first_set=1&last_set=2&format=npz")
    assert answer.status_code == 422
    detail = answer.json()["detail"]
    assert f"{2 * SHOTS} records of {record.waveform.counts.size} samples" in detail
    assert f"at most {one_set / 1e6:.0f} MB" in detail
    assert "solimon export --hdf5" in detail
    monkeypatch.setattr(records, "MOST_SETS", 2)
    assert "more than 2 sets" in api.get("/api/v1/waveforms/B?format=npz").json()["detail"]


def test_an_unreadable_record_is_marked_and_has_no_voltages(tmp_path):
    with filled_folder(tmp_path, shots_per_set=SHOTS) as filled:
        for index in (0, 1):
            filled.add_set(index)
        (tmp_path / "sets" / "away").mkdir()
        next((tmp_path / "sets").glob("set_000001_*.h5")).rename(tmp_path / "sets" / "away" / "set.h5")
        with served(filled.settings, tmp_path) as service, service.client() as api:
            found = read_npz(exported(api, "B", "npz"))
            table = parquet.read_table(io.BytesIO(exported(api, "B", "parquet"))).to_pandas()
            cells = exported(api, "B", "csv")
    assert found["readable"].tolist() == [1] * SHOTS + [0] * SHOTS
    assert np.isnan(found["voltage_v"][SHOTS:]).all()
    assert np.isfinite(found["voltage_v"][:SHOTS]).all()
    assert json.loads(found["solimon"].item())["n_unreadable"] == SHOTS
    assert table["readable"].tolist() == [True] * SHOTS + [False] * SHOTS
    assert cells.splitlines()[1].endswith(b"," * SHOTS), "empty cells, which every spreadsheet knows"
    assert pd.read_csv(io.BytesIO(cells)).iloc[:, 1 + SHOTS :].isna().all(axis=None)
