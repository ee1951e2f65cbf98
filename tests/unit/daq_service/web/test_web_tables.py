"""Exported tables read back equal in pandas, pyarrow, numpy, scipy, h5py and silx."""

import io
import json
import math
import sys
import threading
from dataclasses import replace

import h5py
import numpy as np
import pandas as pd
import pyarrow
import pytest
import silx.io
import silx.io.nxdata
from pyarrow import parquet
from scipy.io import loadmat
from support.filled_folder import LIMIT_CHART, filled_folder, frozen_baseline

from daq_service.catalogue import SetCommit
from daq_service.catalogue.published_columns import add_nested
from daq_service.catalogue.rows import AlarmRow
from daq_service.web.routes import tables
from daq_service.web.tables import choice
from daq_service.web.tables.choice import TABLES
from daq_service.web.tables.formats import FORMATS, MATLAB_NAME

N_SETS = 60
DIAGNOSIS = {"probabilities": {"ok": 0.1, "wall": 0.9, "sensor": 0.0, "coupling": 0.0, "environment": 0.0}}
BASELINE_QUALITY = {
    "n_eff": 34.0,
    "phi_pooled": 0.17,
    "tail": 1.5,
    "rate_not_verified_reason": "48 sets are few",
}
LISTED = {"shot_features": ("features", {"scope": "shot"})}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), shots_per_set=2) as folder:
        assessment_of = folder.assessment

        def with_a_cause(position, index, hour):
            row = assessment_of(position, index, hour)
            return replace(row, diagnosis_details=DIAGNOSIS) if (position, index) == ("B", 55) else row

        folder.assessment = with_a_cause
        for index in range(N_SETS):
            folder.add_set(index, stored=index == 0, assessed=index != 7)
            folder.add_environment(index)
        folder.shelve(folder.add_alarm("B", 55), "a new coil comes", for_h=1.0)
        folder.annotate(3.0, to_h=5.5, position="B", text="couplant, renewed\nby hand")
        folder.annotate(4.0, "an instant")
        folder.add_confirmation("C", 10)
        frozen = frozen_baseline("B", id=2, baseline_quality=BASELINE_QUALITY)
        folder.catalogue.commit_set(SetCommit(baselines=[frozen]))
        whole = {"priority": "critical", "kind": "disk_space", "message": "Ø, 5 %"}
        folder.shelve(folder.add_alarm(None, 50, state="acknowledged", **whole), "a disk comes", for_h=72.0)
        yield folder


@pytest.fixture
def small_pages(monkeypatch):
    """Shorten the pages so that they end within the tables of this test."""
    monkeypatch.setattr(choice, "PAGE_ROWS", 50)


def listed(api, table, **query):
    """Return the rows as the page gets them, without their age, nested values as JSON text."""
    resource, fixed = LISTED.get(table, (table, {}))
    most = {} if table == "baselines" else {"limit": 1000}  # there are few: they come without pages
    rows = api.get(f"/api/v1/{resource}", params={**most, **fixed, **query}).raise_for_status().json()
    nested = (dict, list)
    return [
        {
            name: json.dumps(value, ensure_ascii=False) if isinstance(value, nested) else value
            for name, value in add_nested(TABLES[table].row, row).items()
            if name != "age_h"
        }
        for row in rows["items"]
    ]


def exported(api, table, form, **query):
    answer = api.get(f"/api/v1/tables/{table}", params={"format": form, **query})
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].partition(";")[0] == FORMATS[form].media_type
    return answer.content


def as_stored(value, column):
    """Return a value as stored in formats without "not available"."""
    if value is None:
        return {"number": math.nan, "integer": -1, "truth": -1}.get(column.form, "")
    return value


def check_arrays(read, rows, table):
    for column in TABLES[table].columns:
        expected = np.array([as_stored(row[column.name], column) for row in rows])
        np.testing.assert_array_equal(read(column.name), expected, err_msg=column.name)


@pytest.mark.usefixtures("small_pages")
@pytest.mark.parametrize("table", TABLES)
def test_every_table_is_the_listing_in_every_format(api, table):
    rows = listed(api, table)
    assert rows
    if table not in ("alarms", "annotations", "baselines", "wall"):
        assert len(rows) > choice.PAGE_ROWS, "several pages"
    names = [column.name for column in TABLES[table].columns]
    errors = {name for name in rows[0] if name.startswith("standard_error")}
    assert set(names) == set(rows[0]) - (errors if table == "shot_features" else set())

    csv = pd.read_csv(io.BytesIO(exported(api, table, "csv")), dtype=str, keep_default_na=False)
    assert list(csv) == names
    for column in TABLES[table].columns:
        for cell, row in zip(csv[column.name], rows, strict=True):
            value = row[column.name]
            if value is None:
                assert cell == ""
            elif column.form == "number":
                assert float(cell) == value, "to the last bit"
            else:
                assert cell == (str(value).lower() if column.form == "truth" else str(value))

    for read in (
        parquet.read_table(io.BytesIO(exported(api, table, "parquet"))),
        pyarrow.ipc.open_stream(exported(api, table, "arrow")).read_all(),
    ):
        for column in TABLES[table].columns:
            values = read[column.name].to_pandas()
            unit = (read.schema.field(column.name).metadata or {}).get(b"unit", b"").decode()
            assert unit == column.unit
            for value, row in zip(values, rows, strict=True):
                expected = row[column.name]
                if expected is None:
                    assert pd.isna(value)
                else:
                    assert value == (pd.Timestamp(expected) if column.form == "time" else expected), (
                        column.name
                    )
        assert json.loads(read.schema.metadata[b"solimon"])["table"] == table

    with np.load(io.BytesIO(exported(api, table, "npz"))) as arrays:
        check_arrays(lambda name: arrays[name], rows, table)
        assert json.loads(arrays["solimon"].item())["now_h"] == 30.0

    mat = loadmat(io.BytesIO(exported(api, table, "mat")), squeeze_me=True, chars_as_strings=True)
    struct = mat[table]

    def of_matlab(name):
        values = np.atleast_1d(struct[name].item())
        texts = values.dtype == object  # an empty text is an empty matrix there
        return np.array([v if isinstance(v, str) else "" for v in values]) if texts else values

    check_arrays(of_matlab, rows, table)
    assert all(MATLAB_NAME.fullmatch(name) for name in (table, *names))
    units = {name: str(mat["units"][name].item()) for name in mat["units"].dtype.names}
    assert units == {column.name: column.unit for column in TABLES[table].columns if column.unit}

    with h5py.File(io.BytesIO(exported(api, table, "h5"))) as file:
        group = file["entry"][table]
        check_arrays(
            lambda name: group[name].asstr()[()] if group[name].dtype.kind == "S" else group[name][()],
            rows,
            table,
        )
        for column in TABLES[table].columns:
            assert group[column.name].attrs.get("units", "") == column.unit


def test_a_selection_has_its_columns_and_their_keys(api):
    query = {"position": "B", "from_h": 5.0, "to_h": 10.0}
    rows = listed(api, "features", **query)
    assert len(rows) == 10
    csv = pd.read_csv(io.BytesIO(exported(api, "features", "csv", fields="tof_pp_s,noise_rms_v", **query)))
    assert csv["tof_pp_s"].tolist() == [row["tof_pp_s"] for row in rows]
    assert {"due_h", "due_utc", "quality", "set_index", "position"} <= set(csv)
    assert not {"tof_ac_s", "amplitude_ratio"} & set(csv)
    for table in ("sets", "features", "assessments"):
        rows = listed(api, table, purpose="confirmation", position="C")
        csv = pd.read_csv(io.BytesIO(exported(api, table, "csv", purpose="confirmation")))
        assert csv["id"].tolist() == [row["id"] for row in rows]
        assert len(csv) == 1
        both = pd.read_csv(io.BytesIO(exported(api, table, "csv", purpose="any", position="C")))
        assert len(both) == 1 + len(listed(api, table, position="C"))
    alarms = pd.read_csv(io.BytesIO(exported(api, "alarms", "csv", from_h=26.0)))
    assert alarms["raised_h"].tolist() == [28.0]
    assert len(pd.read_csv(io.BytesIO(exported(api, "features", "csv", from_h=1e6)))) == 0


def test_nested_values_have_their_own_columns(api):
    assessments = pd.read_csv(io.BytesIO(exported(api, "assessments", "csv", position="B")))
    assert assessments["mewma_limit"].tolist() == [LIMIT_CHART] * len(assessments)
    assert assessments["probability_wall"].dropna().tolist() == [0.9], "of the one set with a cause"
    assert assessments["probability_ok"].dropna().tolist() == [0.1]
    assert json.loads(assessments["limits"][0])["mewma"] == LIMIT_CHART
    baselines = pd.read_csv(io.BytesIO(exported(api, "baselines", "csv"))).set_index("name")
    assert baselines["state"].to_dict() == {
        "B-baseline-1": "approved",
        "C-baseline-1": "collecting",
        "D-baseline-1": "collecting",
    }
    first = baselines.loc["B-baseline-1"]
    assert (first["from_h"], first["to_h"], first["n_sets"]) == (0.5, 24.0, 48)
    assert (first["n_eff"], first["phi_pooled"], first["tail"]) == (34.0, 0.17, 1.5)
    assert (first["mewma_limit"], first["rate_not_verified_reason"]) == (LIMIT_CHART, "48 sets are few")
    assert baselines.loc["C-baseline-1", "mewma_limit"] != LIMIT_CHART
    later = pd.read_csv(io.BytesIO(exported(api, "baselines", "csv", from_h=24.5, position="B")))
    assert len(later) == 0


def test_an_expired_shelf_is_absent_in_a_file(filled, api):
    stored = {row.suppressed for row in filled.catalogue.rows(AlarmRow)}
    assert stored == {"shelved"}, "nobody has noted yet that one is over"
    alarms = pd.read_csv(io.BytesIO(exported(api, "alarms", "csv")), keep_default_na=False)
    assert dict(zip(alarms["kind"], alarms["suppressed"], strict=True)) == {
        "wall_change": "",
        "disk_space": "shelved",
    }


def test_viewers_plot_the_chosen_number_over_the_hour(api, tmp_path):
    path = tmp_path / "part.h5"
    path.write_bytes(exported(api, "features", "h5", position="B", fields="amplitude_ratio"))
    with silx.io.open(str(path)) as file:
        shown = silx.io.nxdata.get_default(file)
        assert (shown.signal_name, shown.axes_names) == ("amplitude_ratio", ["due_h (h)"])
        assert shown.signal.shape == (N_SETS,)
        assert not shown.issues


def test_the_header_accept_chooses_the_format(api):
    for accept, media_type in {
        "text/csv;q=0.5, application/x-npz": "application/x-npz",
        "application/vnd.apache.parquet;q=0.2, text/csv;q=0.1": "application/vnd.apache.parquet",
        "*/*": "text/csv",
        "text/html": "text/csv",
    }.items():
        answer = api.get("/api/v1/tables/sets", headers={"Accept": accept})
        assert answer.headers["content-type"].partition(";")[0] == media_type
        assert answer.headers["vary"].startswith("Accept")
    assert 'filename="sets_B.csv"' in api.get("/api/v1/tables/sets?position=B").headers["content-disposition"]


@pytest.mark.parametrize(
    ("query", "status", "message"),
    [
        ("nothing", 404, "The tables are sets, features"),
        ("features?position=X", 404, "The positions are"),
        ("features?fields=tof", 422, "has no field tof; choose from"),
        ("features?fields=,", 422, "none named"),
        ("environment?position=B", 422, "has no positions"),
        (
            "alarms?purpose=any",
            422,
            "no unscheduled sets, sets, features, shot_features, assessments have",
        ),
        ("features?from_h=2&to_h=1", 422, "to_h"),
        ("features?format=xlsx", 422, "csv"),
    ],
)
def test_an_impossible_export_is_rejected_with_its_reason(api, query, status, message):
    answer = api.get(f"/api/v1/tables/{query}")
    assert answer.status_code == status
    assert message in answer.text


def test_every_response_is_bounded(api, monkeypatch):
    monkeypatch.setattr(tables, "MOST_ROWS", 100)
    answer = api.get("/api/v1/tables/features?format=npz")
    assert answer.status_code == 422
    assert "more than 100 rows" in answer.json()["detail"]
    assert (
        len(listed(api, "features")) == len(pd.read_csv(io.BytesIO(exported(api, "features", "csv")))) == 180
    )
    monkeypatch.setattr(tables, "_making", threading.BoundedSemaphore(1))
    with tables._making:
        busy = api.get("/api/v1/tables/features?format=npz&position=B")
        assert (busy.status_code, busy.headers["retry-after"]) == (503, "1")
        assert exported(api, "features", "csv")
    assert exported(api, "features", "npz", position="B")


def test_without_pyarrow_the_other_formats_are_offered(api, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    answer = api.get("/api/v1/tables/features?format=parquet")
    assert answer.status_code == 422
    assert "pip install 'solimon[parquet]'" in answer.json()["detail"]


def test_the_list_of_tables_has_columns_units_and_formats(api):
    listing = api.get("/api/v1/tables").json()
    assert listing["formats"] == list(FORMATS)
    (features,) = [item for item in listing["items"] if item["table"] == "features"]
    assert {"name": "tof_pp_s", "form": "number", "unit": "s"} in features["columns"]


def test_an_unscheduled_set_has_one_key_in_rows_filters_and_paths(api):
    for path in ("sets", "assessments", "features?scope=set"):
        listing = f"/api/v1/{path}{'&' if '?' in path else '?'}position=C&set_index="
        (planned,), (unscheduled,) = (api.get(listing + key).json()["items"] for key in ("10", "10.1"))
        keys = [(row["set_index"], row["unscheduled_index"]) for row in (planned, unscheduled)]
        assert keys == [(10, 0), (10, 1)]
        assert api.get(listing + "10.2").json()["items"] == []
        assert api.get(listing + "10.").status_code == 422
    missing = api.get("/api/v1/sets/C/10.1/shots")
    assert (missing.status_code, missing.json()["detail"]) == (
        404,
        "No shot of position C, set 10.1 is stored.",
    )
