"""The client returns the same numbers from a folder and a service, which are those of the API."""

import os
import subprocess
import sys

import httpx2
import numpy as np
import pandas as pd
import pytest
import xarray
from support.filled_folder import filled_folder, frozen_baseline
from support.served_web import served

from daq_service import client
from daq_service.catalogue import SetCommit
from daq_service.catalogue.published_columns import add_nested
from daq_service.catalogue.rows import AssessmentRow
from daq_service.client.connection import Connection, parse_events
from daq_service.errors import StorageError
from daq_service.settings.tree import Settings
from daq_service.web.auth.tokens import create_token

N_SETS = 60
TABLES = {
    "features": lambda test: test.features(),
    "features?scope=shot&position=B": lambda test: test.features("B", scope="shot"),
    "assessments?position=B&from_h=5&to_h=20": lambda test: test.assessments("B", from_h=5, to_h=20),
    "thickness": lambda test: test.thickness(),
    "sets?position=C": lambda test: test.sets("C"),
    "sets?purpose=any&position=C": lambda test: test.sets("C", purpose="any"),
    "features?purpose=confirmation": lambda test: test.features(purpose="confirmation"),
    "assessments?purpose=confirmation": lambda test: test.assessments(purpose="confirmation"),
    "environment": lambda test: test.environment(),
    "alarms": lambda test: test.alarms(),
    "annotations": lambda test: test.annotations(),
}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), shots_per_set=2) as folder:
        for index in range(N_SETS):
            folder.add_set(index, stored=index in (3, 4, N_SETS - 1))
            if index > 1:
                folder.add_environment(index)
        folder.add_alarm("B", 55)
        folder.add_confirmation("C", N_SETS - 1)
        retired = {"retired_by": "ben", "retired_reason": "coupled anew", "retired_utc_ns": folder.epoch_ns}
        second = {
            "name": "B-baseline-2",
            "state": "collecting",
            "first_set_index": 400,
            "last_set_index": 424,
        }
        for row in (
            frozen_baseline("B", state="retired", **retired),
            frozen_baseline("B", **second),
            frozen_baseline("C", approved_utc_ns=folder.epoch_ns),
        ):
            folder.catalogue.commit_set(SetCommit(baselines=[row]))
        folder.annotate(3.0, to_h=5.5, position="B", text="couplant renewed")
        folder.add_alarm(None, 50, state="acknowledged", priority="critical", kind="disk_space")
        yield folder


@pytest.fixture(scope="module")
def service(filled):
    with served(filled.settings, filled.folder) as running:
        yield running


@pytest.fixture(scope="module")
def of_folder(filled):
    with client.open(filled.folder) as test:
        yield test


@pytest.fixture(scope="module")
def of_service(service):
    with client.open(service.url) as test:
        yield test


@pytest.mark.parametrize("resource", TABLES)
def test_folder_service_and_page_agree(resource, of_folder, of_service, service):
    here, there = TABLES[resource](of_folder), TABLES[resource](of_service)
    pd.testing.assert_frame_equal(here, there, check_exact=True)
    with service.client() as http:
        path, _, query = resource.partition("?")
        page = http.get(f"/api/v1/{path}?limit=1000&{query}").json()
    items = [add_nested(AssessmentRow, item) if path == "assessments" else item for item in page["items"]]
    if path == "features":
        errors = [column for column in here if column.startswith("standard_error_")]
        assert errors
        for item in items:
            found = item.get("standard_error") or {}
            item |= {name: found.get(name.removeprefix("standard_error_")) for name in errors}
    assert len(here) == len(items) > 0
    for column in here:
        for value, expected in zip(here[column], [item[column] for item in items], strict=True):
            if expected is None:
                assert value is None or pd.isna(value), column
            elif column.endswith("_utc"):
                assert value == pd.Timestamp(expected), column
            else:
                assert value == expected, column
    assert set(here) == set(items[0]), "nothing that the page has is missing"


def test_the_baselines_of_a_position_have_their_lifecycle(of_folder, of_service):
    here, there = of_folder.baselines("B"), of_service.baselines("B")
    pd.testing.assert_frame_equal(here, there, check_exact=True)
    assert here["name"].tolist() == ["B-baseline-1", "B-baseline-2"]
    assert here["state"].tolist() == ["retired", "collecting"]
    assert (here["retired_by"][0], here["retired_reason"][0]) == ("ben", "coupled anew")
    assert here["retired_utc"].tolist() == [pd.Timestamp("2024-01-01T00:00Z"), pd.NaT]
    # Around sets 2 to 47 it was 21.5 degrees, around 400 to 424 nothing was measured.
    assert here["temperature_c"].tolist() == [[21.5, 21.5], None]
    # Sets come half-hourly up to hour 75, then hourly, and set 0 is half an hour after the begin.
    assert here[["from_h", "to_h"]].values.tolist() == [[0.5, 24.0], [326.0, 350.0]]
    every = of_folder.baselines()
    assert every["position"].tolist() == ["B", "B", "C", "D"]
    # Position D has no row before its first baseline is frozen.
    first = every.iloc[-1]
    assert (first["name"], first["state"], first["id"]) == ("D-baseline-1", "collecting", 4)
    assert (first["first_set_index"], first["last_set_index"], first["n_sets"]) == (0, 47, 48)
    assert first["created_utc"] == pd.Timestamp("2024-01-01T00:00Z")


def test_columns_have_units_and_types_also_without_values(of_folder):
    features = of_folder.features("B")
    assert features["ssw_amplitude_v"].isna().all()
    assert features["ssw_amplitude_v"].dtype == np.float64
    assert features["shot_index"].dtype == "Int64"
    assert features.attrs["units"]["tof_pp_s"] == "s"
    assert features.attrs["units"]["psw_area_v_s"] == "V s"
    assert features.attrs["as_of"]["recorder"] == "running"
    empty = of_folder.features("B", from_h=1e6)
    assert list(empty) == list(features)
    assert empty.dtypes.to_dict() == features.dtypes.to_dict()


def test_waveforms_are_the_records_in_volts(filled, of_folder, of_service, service):
    both = [test.waveforms("B", from_h=2.0, to_h=2.6) for test in (of_folder, of_service)]
    xarray.testing.assert_identical(*both)
    waves = both[0]
    records = [record for index in (3, 4) for record in filled.records(index) if record.key.position == "B"]
    assert waves["set_index"].values.tolist() == [3, 3, 4, 4]
    np.testing.assert_array_equal(waves, [record.waveform.volts() for record in records])
    np.testing.assert_array_equal(waves["time"], records[0].waveform.time_s())
    assert (waves.attrs["units"], waves["time"].attrs["units"]) == ("V", "s")
    assert waves["quality"].values.tolist() == ["good"] * 4
    assert waves["due_h"].values.tolist() == [2.0, 2.0, 2.5, 2.5]
    assert waves["utc"].values.astype("int64").tolist() == [record.stamp.utc_ns for record in records]
    with service.client() as http:
        shown = http.get("/api/v1/waveforms/B/3/1").json()
    assert waves[1].values.tolist() == shown["voltage_v"]


def test_waveforms_of_the_newest_set_and_of_the_probe(of_folder):
    assert of_folder.waveforms("B")["set_index"].values.tolist() == [N_SETS - 1] * 2
    echo = of_folder.waveforms("A", 3)
    assert echo.shape == (1, 2000)
    assert echo["quality"].values.tolist() == ["good"]


@pytest.mark.parametrize(
    ("query", "message"),
    [
        (lambda test: test.waveforms("B", 10), "not stored"),
        (lambda test: test.waveforms("X"), "the positions are A, B, C, D"),
        (lambda test: test.waveforms("B", 3, from_h=1.0), "either set_index or a range"),
        (lambda test: test.features("X"), "There is no position 'X'. The positions are A, B, C, D."),
        (lambda test: test.assessments(from_h=5, to_h=1), "Let to_h be at least from_h"),
    ],
)
def test_an_impossible_request_has_its_reason(query, message, of_folder, of_service):
    for test in (of_folder, of_service):
        with pytest.raises(client.ClientError, match=message):
            query(test)


def test_an_empty_folder_and_a_silent_address_raise_errors(tmp_path, service):
    with pytest.raises(StorageError):
        client.open(tmp_path)
    with (
        client.open("http://127.0.0.1:9") as unreachable,  # the discard port: no server listens
        pytest.raises(client.UnreachableError, match="solimon serve"),
    ):
        unreachable.info()
    with client.open(service.url + "static/") as elsewhere, pytest.raises(client.RefusedError):
        elsewhere.info()


@pytest.mark.parametrize("way", ["of_folder", "of_service"])
def test_events_are_followed_from_the_last_one(way, filled, request):
    test = request.getfixturevalue(way)
    first = test.info()["last_event_id"]
    event_id = filled.say("noted", text="one")
    filled.say("noted", text="two")
    events = test.follow("service", after=first)
    event = next(events)
    assert (event.id, event.topic, event.kind) == (event_id, "service", "noted")
    assert event.data["payload"]["text"] == "one"
    again = next(test.follow("service", after=event.id))
    assert again.data["payload"]["text"] == "two"


def test_a_token_is_sent_as_a_bearer_s(monkeypatch):
    given = []
    monkeypatch.setattr(httpx2, "Client", lambda **options: given.append(options))
    client.open("http://127.0.0.1:8750", token="abc")
    monkeypatch.setenv("SOLIMON_TOKEN", "def")
    client.open("https://rig.example")
    client.open("https://rig.example", token="abc")
    sent = [options["headers"]["Authorization"] for options in given]
    assert sent == ["Bearer abc", "Bearer def", "Bearer abc"]


@pytest.mark.parametrize("of_its_own", [False, True])
def test_a_folder_is_read_without_a_token_also_where_its_service_asks_for_one(tmp_path, of_its_own):
    """A user who may read the files needs no other permission."""
    (data := tmp_path / "data").mkdir()
    tokens = tmp_path / "rig-tokens.json" if of_its_own else data / "tokens.json"
    web = {"tokens_file": str(tokens)} if of_its_own else {}
    create_token(tokens, "ann", "admin")
    with filled_folder(data, Settings(web=web), sets=1) as filled:
        with client.open(data) as test:
            assert test.info()["name"] == filled.settings.name
            assert len(test.features("B")) == 1
        with (
            served(filled.settings, data) as running,
            client.open(running.url) as test,
            pytest.raises(client.RefusedError, match="access token"),
        ):
            test.info()


def test_a_folder_is_read_though_its_service_is_reachable_from_elsewhere(tmp_path):
    web = {"host_names": ["rig.example"], "proxy": "127.0.0.1"}
    with filled_folder(tmp_path, Settings(web=web), sets=1), client.open(tmp_path) as test:
        assert len(test.features("B")) == 1


def test_the_stream_s_heartbeats_and_goodbye_are_no_events():
    lines = [": heartbeat", "", "id: 7", "event: gap", 'data: {"after": 1}', "", "event: bye", "data: {}", ""]
    assert list(parse_events(iter(lines))) == [{"topic": "gap", "kind": "gap", "after": 1, "id": 7}]


HEAVY = (
    "numba llvmlite nidaqmx niscope serial pyvisa nptdms matplotlib scipy.special scipy.optimize scipy.signal"
)


@pytest.mark.parametrize("way", ["folder", "service"])
def test_the_client_imports_nothing_heavy(way, filled, service):
    where = str(filled.folder) if way == "folder" else service.url
    more = "" if way == "folder" else " fastapi sqlalchemy h5py pydantic"
    script = (
        # Where it is installed xarray imports Dask, and that SciPy: it is no part of the client.
        "import sys; sys.modules['dask'] = None\n"
        "from daq_service import client\n"
        f"with client.open({where!r}) as test:\n"
        "    assert len(test.features('B')) == 60 and test.waveforms('B', 3).shape[0] == 2\n"
        f"print(*[name for name in {(HEAVY + more).split()} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, env=dict(os.environ)
    )
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr


def test_a_connection_that_is_closed_ends_who_follows(of_service, service):
    connection = Connection(httpx2.Client(base_url=service.url))
    connection.close()
    assert list(connection.events(0, None)) == []
