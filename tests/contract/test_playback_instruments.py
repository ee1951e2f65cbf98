"""Recorded instruments keep the contracts of the real ones for any source of shots."""

import numpy as np
import pytest
from support.archived_sets import SET_INDEX, make_echo, make_set, make_shot, other_set
from support.filed_archive import FiledArchive
from support.labview_files import write_set
from support.shots_in_memory import shots_in_memory

from daq_service.rig.playback import open_recording
from hardware_drivers.conformance.clock_contract import ClockContract
from hardware_drivers.conformance.digitizer_contract import DigitizerContract
from hardware_drivers.conformance.pulse_echo_unit_contract import PulseEchoUnitContract
from hardware_drivers.conformance.striker_contract import StrikerContract
from hardware_drivers.measurement import ShotKey
from hardware_drivers.playback.clock import RecordedClock
from hardware_drivers.playback.instruments import build_instruments
from hardware_drivers.playback.parameters import PlaybackParameters, TdmsMapping
from simulator.clock import SimulatedClock


def recorded():
    """Return two sets of an ultrasonic and two solitary-wave positions."""
    first = make_set()
    return [first, other_set(first, SET_INDEX + 1)]


@pytest.fixture(params=["memory", "archive", "tdms"])
def instruments(request, tmp_path):
    if request.param == "memory":
        yield build_instruments(shots_in_memory(record for one in recorded() for record in one.records))
        return
    parameters = PlaybackParameters(source=tmp_path)
    if request.param == "archive":
        archive = FiledArchive(tmp_path)
        for one in recorded():
            archive.store_set(one)
    else:
        for set_index in (SET_INDEX, SET_INDEX + 1):
            # LabVIEW's files know no attempts, and hold one type of codes here.
            shots = [make_shot(name, index, 10 * index) for name in ("B", "C") for index in (0, 1)]
            write_set(tmp_path, set_index, [make_echo(40), *shots])
        mapping = TdmsMapping(pulse_echo_positions=("A",), gain_db=31.5, averages=64)
        parameters = PlaybackParameters(source=tmp_path, format="tdms", tdms=mapping)
    with open_recording(parameters, tmp_path) as source:
        yield build_instruments(source)


class Unwired:
    @pytest.fixture
    def unknown_key(self):
        return ShotKey(position="nowhere", set_index=SET_INDEX, shot_index=0)


class TestRecordedDigitizer(Unwired, DigitizerContract):
    @pytest.fixture
    def digitizer(self, instruments):
        return instruments.digitizer

    @pytest.fixture
    def strike(self, instruments):
        return instruments.striker.strike

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position="B", set_index=SET_INDEX, shot_index=i) for i in (0, 1))


class TestRecordedStriker(Unwired, StrikerContract):
    @pytest.fixture
    def striker(self, instruments):
        return instruments.striker

    @pytest.fixture
    def coil_levels(self, instruments):
        return lambda: instruments.striker.switchings

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position=name, set_index=SET_INDEX, shot_index=0) for name in ("B", "C"))


class TestRecordedPulseEchoUnit(Unwired, PulseEchoUnitContract):
    @pytest.fixture
    def pulse_echo(self, instruments):
        return instruments.pulse_echo

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position="A", set_index=SET_INDEX + i, shot_index=0) for i in (0, 1))


class TestRecordedClock(ClockContract):
    """Recorded times a little after every fourth second."""

    AHEAD_S = 0.0

    @pytest.fixture
    def clock(self):
        start_ns = 1_704_067_200_000_000_000
        moments = start_ns + np.arange(1, 100) * 4_000_000_000 + 1_234_567
        return RecordedClock(
            SimulatedClock(start_ns), lambda after: next((int(m) for m in moments if m > after), None)
        )
