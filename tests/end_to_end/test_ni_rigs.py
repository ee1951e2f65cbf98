"""Whole sets through the vendor's unmodified packages, with the twin below them."""

import threading
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import pytest
from support.daqmx_models import running_brain
from support.niscope_rig import preload
from support.stored_files import read_set, set_files

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import FeatureRow, SetRow
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder
from daq_service.recording.session import record_test
from daq_service.rig.doubles import run_rig_doubles
from daq_service.rig.open_rig import CONTROL_VARIABLE, open_rig
from simulator.doubles.transports.control import DoublesControl
from simulator.doubles.transports.grpc_front import find_unavailability_reason as why_no_grpc
from simulator.doubles.transports.library import find_unavailability_reason as why_no_library

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


@contextmanager
def rig_here(rig):
    """Run a rig whose libraries this process loads; its double is forked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simulator.doubles.transports.control.running_doubles", running_brain)
        with run_rig_doubles(rig, SMALL) as running:
            if rig == "daqmx-library":
                preload("nidaqmx")
                if find_spec("niscope") is not None:
                    preload("niScope")
            for name, text in running.environment.items():
                patch.setenv(name, text)
            yield running


def follow(running, folder):
    """Run the schedule in this process."""
    prepare_data_folder(folder)
    with hold_recorder_lock(folder):
        return record_test(
            running.settings, folder, open_rig, stop=threading.Event(), report=lambda event, **_: None
        )


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
        events = catalogue.read_events_after(0, {"service"}, limit=None)
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
