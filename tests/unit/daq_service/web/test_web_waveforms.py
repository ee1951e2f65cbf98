"""Stored records in volts, and the live figure by GET and by WebSocket."""

import io
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from support.filled_folder import filled_folder, served_folder
from support.served_web import DEADLINE_S, served
from support.stored_files import read_waveform, set_files
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from daq_service.catalogue.rows import SetRow
from daq_service.recording.set_assessor import build_shot_row
from daq_service.settings.tree import Settings
from daq_service.web.answers.problem import Problem
from daq_service.web.routes.waveforms import find_extremes_per_bin
from daq_service.web.streams.live_figures import decode_figure_header
from hardware_drivers.measurement import SetKey


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), shots_per_set=2) as folder:
        folder.add_set(0, shown=True)
        yield folder


def stored(filled, position, shot_index):
    return read_waveform(set_files(filled.folder)[0], position, shot_index)


def live_record(content):
    (length,) = struct.unpack_from("<I", content)
    header = json.loads(content[4 : 4 + length])
    assert (4 + length) % 8 == 0
    return header, np.frombuffer(content[4 + length :], dtype=np.dtype(header["dtype"]).newbyteorder("<"))


def records_of_a_set(content):
    (length,) = struct.unpack_from("<I", content)
    header, at = json.loads(content[4 : 4 + length]), 4 + length
    for record in header["records"]:
        counts = np.frombuffer(
            content, dtype=np.dtype(record["dtype"]).newbyteorder("<"), count=record["n_samples"], offset=at
        )
        at += counts.nbytes
        yield record, counts
    assert at == len(content)


@pytest.mark.parametrize(("position", "shots"), [("B", 2), ("A", 1)])
def test_one_response_has_all_records_of_a_set(api, filled, position, shots):
    answer = api.get(f"/api/v1/sets/{position}/0/waveforms")
    found = list(records_of_a_set(answer.content))
    assert [record["shot_index"] for record, _ in found] == list(range(shots))
    for record, counts in found:
        waveform = stored(filled, position, record["shot_index"])
        np.testing.assert_array_equal(counts, waveform.counts)
        assert record["sample_rate_hz"] == waveform.sample_rate_hz
        assert record["pretrigger_samples"] == waveform.pretrigger_samples


def test_marks_are_within_their_search_windows(tmp_path):
    settings = Settings(ultrasound={"delay_s": 1e-6})
    with served_folder(tmp_path, settings, sets=1, stored=True) as (_, api):

        def windows_s(position):
            content = api.get(f"/api/v1/sets/{position}/0/waveforms").content
            (length,) = struct.unpack_from("<I", content)
            return json.loads(content[4 : 4 + length])["windows_s"]

        (feature,) = api.get("/api/v1/features?position=B&set_index=0&scope=set").json()["items"]
        (wall,) = api.get("/api/v1/thickness?position=A&set_index=0").json()["items"]
        isw_s, psw_s, echo_s = feature["isw_time_s"], feature["psw_time_s"], wall["travel_time_s"]
        # Defaults of `ExtractionSettings`, counted from the ISW, and for the SSW from the PSW.
        assert windows_s("B") == {
            "ISW": pytest.approx([isw_s - 90e-6, isw_s + 90e-6]),
            "PSW": pytest.approx([isw_s + 200e-6, isw_s + 900e-6]),
            "SSW": pytest.approx([psw_s + 90e-6, psw_s + 350e-6]),
        }
        # The only record of the probe is its reference; the second echo has gone through the wall twice.
        assert windows_s("A") == {
            "first echo": pytest.approx([1e-6 + 0.1 * (echo_s - 1e-6), 1e-6 + 1.15 * (echo_s - 1e-6)]),
            "second echo": pytest.approx([2 * echo_s - 1e-6] * 2),
        }


def test_a_repeated_record_is_not_among_those_of_its_set(tmp_path, monkeypatch):
    def repeated(record, **columns):
        row = build_shot_row(record, **columns)
        return replace(row, outcome="superseded") if row.shot_index == 1 else row

    monkeypatch.setattr("support.filled_folder.build_shot_row", repeated)
    with served_folder(tmp_path, shots_per_set=2, sets=1, stored=True) as (_, api):
        found = list(records_of_a_set(api.get("/api/v1/sets/B/0/waveforms").content))
        assert [record["shot_index"] for record, _ in found] == [0]
        assert api.get("/api/v1/sets/B/1/waveforms").status_code == 404


@pytest.mark.parametrize(("position", "shot_index"), [("B", 0), ("D", 1), ("A", 0)])
def test_a_stored_record_is_returned_in_volts(api, filled, position, shot_index):
    answer = api.get(f"/api/v1/waveforms/{position}/0/{shot_index}").json()
    waveform = stored(filled, position, shot_index)
    np.testing.assert_array_equal(answer["voltage_v"], waveform.volts())
    np.testing.assert_array_equal(answer["time_s"], waveform.time_s())
    assert answer["n_samples"] == waveform.counts.size
    assert answer["downsampled"] is False
    assert (answer["quality"], answer["valid"], answer["flags"]) == ("good", True, [])
    assert answer["due_h"] == 0.5


def test_npy_is_time_and_volts(api, filled):
    answer = api.get("/api/v1/waveforms/C/0/1?format=npy")
    assert answer.headers["content-type"] == "application/x-npy"
    waveform = stored(filled, "C", 1)
    np.testing.assert_array_equal(
        np.load(io.BytesIO(answer.content)), np.stack([waveform.time_s(), waveform.volts()])
    )


@pytest.mark.parametrize("form", ["npy", "octets"])
def test_a_record_that_the_client_has_is_not_read_again(service, api, filled, form, monkeypatch):
    url = f"/api/v1/waveforms/B/0/0?format={form}"
    (row,) = filled.catalogue.rows(SetRow, position="B", set_index=0)
    filled.catalogue.store_digest(SetKey(0), row.file, "ab" * 32)
    etag = api.get(url).headers["etag"]
    assert etag != api.get(f"{url}&points=8").headers["etag"]
    monkeypatch.setattr(service.app.state.context, "archive", None)
    known = api.get(url, headers={"If-None-Match": f'"other", W/{etag}'})
    assert known.status_code == 304
    assert known.content == b""


def test_octets_are_counts_with_their_calibration(api, filled):
    answer = api.get("/api/v1/waveforms/B/0/0?format=octets")
    waveform = stored(filled, "B", 0)
    counts = np.frombuffer(answer.content, dtype=answer.headers["x-dtype"])
    np.testing.assert_array_equal(counts, waveform.counts)
    coefficients = [float(text) for text in answer.headers["x-coefficients-v"].split(",")]
    assert coefficients == waveform.calibration.coefficients_v.tolist()
    assert float(answer.headers["x-sample-rate-hz"]) == waveform.sample_rate_hz
    assert int(answer.headers["x-pretrigger-samples"]) == waveform.pretrigger_samples


def test_downsampled_record_keeps_its_extremes(api, filled):
    answer = api.get("/api/v1/waveforms/B/0/0?points=300").json()
    volts = stored(filled, "B", 0).volts()
    assert len(answer["voltage_v"]) <= 300
    assert answer["downsampled"] is True
    assert (min(answer["voltage_v"]), max(answer["voltage_v"])) == (volts.min(), volts.max())
    assert answer["time_s"] == sorted(answer["time_s"])


@given(
    values=arrays.arrays(np.float64, st.integers(1, 200), elements=st.floats(-1e3, 1e3)),
    points=st.integers(4, 60),
)
def test_extremes_of_each_bin_survive(values, points):
    kept = find_extremes_per_bin(values, points)
    assert kept.size <= points
    assert np.all(np.diff(kept) > 0)
    assert values[kept].min() == values.min()
    assert values[kept].max() == values.max()


# Live


def test_the_live_figure_is_the_file_of_the_recorder(api, filled):
    answer = api.get("/api/v1/waveforms/live/B")
    assert answer.content == (filled.folder / "live" / "B.bin").read_bytes()
    header, counts = live_record(answer.content)
    assert (header["position"], header["set_index"]) == ("B", 0)
    assert counts.size == 13_000
    assert answer.headers["x-sequence"] == str(header["sequence"])


def test_a_position_without_a_live_figure_is_404(tmp_path):
    with served(Settings(), tmp_path) as service, service.client() as api:
        assert api.get("/api/v1/waveforms/live/B").status_code == 404


@pytest.mark.parametrize(
    "content", [b"", b"\xff\xff\xff\xff{}", b"\x02\0\0\0[]", struct.pack("<I", 400) + b"{}"]
)
def test_a_corrupt_live_figure_is_a_problem(content):
    with pytest.raises(Problem) as caught:
        decode_figure_header(content)
    assert caught.value.status == 503


def test_a_websocket_sends_the_newest_figure_of_each_position(filled, service):
    with connect(f"ws://{service.netloc}/api/v1/waveforms/live") as socket:
        first = {live_record(socket.recv(timeout=DEADLINE_S))[0]["position"] for _ in range(4)}
        assert first == {"A", "B", "C", "D"}
    with connect(f"ws://{service.netloc}/api/v1/waveforms/live?positions=C") as socket:
        assert live_record(socket.recv(timeout=DEADLINE_S))[0]["position"] == "C"
        filled.show_set(1)
        header, counts = live_record(socket.recv(timeout=DEADLINE_S))
        if header["set_index"] == 0:  # the first set's second shot was read while it was replaced
            header, counts = live_record(socket.recv(timeout=DEADLINE_S))
        assert (header["position"], header["set_index"]) == ("C", 1)
        assert counts.size == 13_000


def test_a_websocket_sends_text_heartbeats_without_figures(service, monkeypatch):
    monkeypatch.setattr(service.app.state.context.hub, "heartbeat_interval_s", 0.05)
    with connect(f"ws://{service.netloc}/api/v1/waveforms/live?positions=C") as socket:
        first, *others = (socket.recv(timeout=DEADLINE_S) for _ in range(4))
    assert isinstance(first, bytes)
    # The second shot of the set that the test before shows may be a figure more.
    texts = [item for item in others if isinstance(item, str)]
    assert len(texts) >= 2
    assert set(texts) == {'{"interval_s":0.05}'}


@pytest.mark.parametrize("positions", ["Z", "B,Z", "", "../secret"])
def test_websocket_for_unknown_positions_is_refused(service, positions):
    with (
        pytest.raises((InvalidStatus, ConnectionClosed)),
        connect(f"ws://{service.netloc}/api/v1/waveforms/live?positions={positions}") as socket,
    ):
        socket.recv(timeout=DEADLINE_S)


def test_client_that_left_is_forgotten(service, api):
    with connect(f"ws://{service.netloc}/api/v1/waveforms/live?positions=B") as socket:
        socket.recv(timeout=DEADLINE_S)
        assert api.get("/api/v1/health").json()["waveform_clients"] >= 1
    for _ in range(500):  # each turn is a request: no waiting by the clock
        if api.get("/api/v1/health").json()["waveform_clients"] == 0:
            return
    pytest.fail("the client that left is still counted")
