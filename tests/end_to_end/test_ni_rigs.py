"""Whole sets through the vendor's unmodified packages, with the twin below them."""

import threading
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import pytest
from support.daqmx_models import running_brain
from support.niscope_rig import preload
from support.stored_files import read_set, set_files
from support.waiting import happened

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import FeatureRow, SetRow
from daq_service.cli.run import child_plans
from daq_service.processes.data_folder import own_data_folder, prepare_data_folder
from daq_service.processes.supervisor import Supervisor
from daq_service.recording.session import record
from daq_service.rig.doubles import running_rig
from daq_service.rig.open_rig import CONTROL_VARIABLE, open_rig
from simulator.doubles.transports.control import DoublesControl
from simulator.doubles.transports.grpc_front import why_unavailable as why_no_grpc
from simulator.doubles.transports.library import why_unavailable as why_no_library

REASONS = {"daqmx-library": why_no_library(), "daqmx-grpc": why_no_grpc()}
NI_RIGS = [
    pytest.param(rig, marks=pytest.mark.skipif(bool(reason), reason=reason or "available"))
    for rig, reason in REASONS.items()
]
SMALL: dict[str, Any] = {
    "schedule": {"phases": [{"until_h": 1.0, "interval_h": 0.5}], "shots_per_set": 2},
    # A coarse mesh: the rigs are compared with each other, not with nature.
    "plate": {"elements_per_edge": 16},
    "baseline": {"minimum_valid_shots": 2},
    "alarms": {"hole_shots": 2},
    # What is left between two rigs is then the board's polynomial and its rounding.
    "twin": {"noise": {"enabled": False}},
}


def configuration(running, folder):
    prepare_data_folder(folder)
    path = folder / "configuration.json"
    path.write_text(running.settings.model_dump_json(), encoding="utf-8")
    return path


@contextmanager
def rig_here(rig, changed=lambda rig: rig):
    """Run a rig whose libraries this process loads; its double is forked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simulator.doubles.transports.control.running_doubles", running_brain)
        with running_rig(rig, SMALL) as running:
            if rig == "daqmx-library":
                preload("nidaqmx")
                if find_spec("niscope") is not None:
                    preload("niScope")
            for name, text in running.environment.items():
                patch.setenv(name, text)
            yield changed(running)


def follow(running, folder, notify=lambda event, **_: None):
    """Run the schedule in this process."""
    prepare_data_folder(folder)
    with own_data_folder(folder):
        return record(running.settings, folder, open_rig, stop=threading.Event(), report=notify)


def shot_features(folder):
    with open_catalogue(folder) as catalogue:
        rows = catalogue.rows(FeatureRow, scope="shot")
    return {(row.position, row.set_index, row.shot_index): row for row in rows}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated")
    with rig_here("simulated") as running:
        assert follow(running, folder)
    return folder


@pytest.mark.parametrize("rig", NI_RIGS)
def test_a_set_through_nidaqmx_equals_the_twin_and_stores_its_settings(rig, simulated, tmp_path):
    with rig_here(rig) as running:
        assert follow(running, tmp_path)
        with DoublesControl(running.environment[CONTROL_VARIABLE]) as doubles:
            driver_record = doubles.record()
    expected, found = shot_features(simulated), shot_features(tmp_path)
    assert found.keys() == expected.keys()
    assert len(found) == 12
    for key, row in found.items():
        # Boards and twin round to codes of their own: 16 bits move a pick by far less than this.
        assert row.tof_pp_s == pytest.approx(expected[key].tof_pp_s, abs=0.02e-6), key
        assert row.tof_mf_s == pytest.approx(expected[key].tof_mf_s, abs=0.02e-6), key
    with open_catalogue(tmp_path) as catalogue:
        assert {row.state for row in catalogue.rows(SetRow)} == {"done"}
        events = catalogue.events_after(0, {"service"}, limit=None)
    # Once at the start, not again within a day; what it says names each board.
    (calibrated,) = [row.payload for row in events if row.kind == "self_calibrated"]
    assert "01E16086" in calibrated
    assert driver_record["tasks"] == []
    assert driver_record["leaked"] == []
    assert driver_record["sessions"] == []
    assert driver_record["reservations"] == {}
    record_ = read_set(set_files(tmp_path)[0])
    assert record_.rig_kind == "daqmx"
    assert record_.provenance["rig_identity"]["doubles"], "data of a double say so"
    shot = record_.shots[0]
    assert shot.settings["product"] == "PXIe-6386"
    assert shot.settings["trigger_level_v"] > 0.0
    assert shot.settings["calibration_date"]
    assert shot.waveform.calibration.coefficients_v.size == 4
    assert shot.truth == {}, "a driver knows nothing of the wall"


SECOND_H = 1.0 / 3600.0
PULSE_NS = 20_000_000


def one_transducer(running, sets, **clock):
    """Return one transducer, a set of one strike every two seconds, and short timeouts."""
    values = running.settings.model_dump(mode="json")
    values["clock"] |= clock
    values["schedule"] |= {
        "phases": [{"until_h": sets * 2.0 * SECOND_H, "interval_h": 2.0 * SECOND_H}],
        "shots_per_set": 1,
    }
    values["baseline"]["minimum_valid_shots"] = 1
    values["alarms"]["hole_shots"] = 1
    values["positions"] = {"D": values["positions"]["D"]}
    values["rig"]["niscope"] = None
    values["rig"]["daqmx"]["transducers"] = {"D": values["rig"]["daqmx"]["transducers"]["D"]}
    # A recorder of a loaded machine that only waits for its set is not taken for hung.
    values["rig"] |= {"read_timeout_s": 1.0, "stall_timeout_s": 5.0}
    return replace(running, settings=type(running.settings)(**values))


def set_states(folder):
    with open_catalogue(folder) as catalogue:
        return [row.state for row in catalogue.rows(SetRow, position="D")]


@pytest.mark.skipif(bool(REASONS["daqmx-library"]), reason=REASONS["daqmx-library"] or "available")
@pytest.mark.parametrize(
    "function", ["DAQmxReadBinaryI16", pytest.param("DAQmxWaitUntilTaskDone", marks=pytest.mark.slow)]
)
def test_a_hung_call_costs_the_sets_of_its_time_and_no_coil_stays_on(function, tmp_path):
    """Nothing can interrupt a hung call of the library but the end of its process."""
    first_set, went_on, stop = threading.Event(), threading.Event(), threading.Event()
    codes: list[int] = []

    def on_message(child, message):
        if message["event"] == "progress":
            first_set.set()
            states = set_states(tmp_path)
            if "missed" in states and states[-1] == "done":
                went_on.set()

    with (
        running_rig("daqmx-library", SMALL) as started,
        DoublesControl(started.environment[CONTROL_VARIABLE]) as doubles,
    ):
        running = one_transducer(started, 1_000, kind="wall")
        config = configuration(running, tmp_path)
        plans = child_plans(
            config, tmp_path, port=None, web=False, linger=False, environment=running.environment
        )
        supervisor = Supervisor(plans, tmp_path, on_message=on_message)
        thread = threading.Thread(target=lambda: codes.append(supervisor.run(stop, stay=False)))
        thread.start()
        try:
            happened(first_set.wait, "a set was taken")
            doubles.inject(function, "hang")
            happened(doubles.wait_until_hanging, "a call hung")
            happened(went_on.wait, "a set was taken after those that were missed")
        finally:
            stop.set()
            thread.join(60.0)
        driver_record = doubles.record()
    assert codes == [0]
    with open_catalogue(tmp_path) as catalogue:
        sets = catalogue.rows(SetRow, position="D")
        starts = catalogue.events_after(0, {"service"}, limit=None)
    # A busy machine may take so long for the start, or for storing a set, that it counts as hung, too.
    restarts = [row.payload["before"] or "" for row in starts if row.kind == "recorder_started"]
    assert any("hung while taking set" in restart for restart in restarts)
    missed = [row for row in sets if row.state == "missed"]
    assert missed, "the sets of that time are gaps in the ledger"
    # Not all: on a busy machine sets may also fall due while the recorder opens the rig.
    assert any("hung while taking set" in row.reason for row in missed)
    # The counter ends each pulse: whatever hung, no level stayed high for longer than the pulse.
    for line in {event["line"] for event in driver_record["lines"]}:
        events = [event for event in driver_record["lines"] if event["line"] == line]
        assert [event["level"] for event in events] == [1, 0] * (len(events) // 2)
        for on, off in zip(events[::2], events[1::2], strict=True):
            assert off["ns"] - on["ns"] <= PULSE_NS * 1.01
    assert not any(driver_record["levels"].values())
