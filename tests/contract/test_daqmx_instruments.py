"""Digitizer and striker on NI-DAQmx keep the contracts, by library and by gRPC, on doubles of NI's driver."""

import pytest
from support.daqmx_rig import TRANSPORTS, parameters_of, quick_description, reach

from hardware_drivers.conformance.digitizer_contract import DigitizerContract
from hardware_drivers.conformance.striker_contract import StrikerContract
from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.instruments import SelfCalibrating
from hardware_drivers.measurement import ShotKey

DESCRIPTION = quick_description()


@pytest.fixture(params=TRANSPORTS)
def transport(request, doubles, monkeypatch):
    reach(request.param, doubles, monkeypatch)
    return request.param


@pytest.fixture(params=[None, 5e-3], ids=["armed over the pulse", "held off"])
def rig(request, doubles, transport):
    doubles.control.clear_record()
    parameters = parameters_of(DESCRIPTION, doubles, transport=transport, holdoff_s=request.param)
    with open_daqmx(parameters) as instruments:
        yield instruments
    record = doubles.control.record()
    assert record["tasks"] == []
    assert record["reservations"] == {}


class Unwired:
    @pytest.fixture
    def unknown_key(self):
        return ShotKey(position="nowhere", set_index=0, shot_index=0)


class TestDaqmxDigitizer(Unwired, DigitizerContract):
    @pytest.fixture
    def digitizer(self, rig):
        return rig.digitizer

    @pytest.fixture
    def strike(self, rig):
        return rig.striker.strike

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position="C", set_index=3, shot_index=i) for i in (0, 1))


class TestDaqmxStriker(Unwired, StrikerContract):
    @pytest.fixture
    def striker(self, rig):
        return rig.striker

    @pytest.fixture
    def coil_levels(self, rig, doubles):
        return lambda: [
            (event["position"], bool(event["level"])) for event in doubles.control.record()["lines"]
        ]

    @pytest.fixture
    def keys(self):
        return tuple(ShotKey(position=name, set_index=0, shot_index=0) for name in ("C", "D"))


def test_it_calibrates_itself(rig):
    assert isinstance(rig.self_calibrating, SelfCalibrating)
    (what,) = rig.self_calibrating.self_calibrate().values()
    assert what.endswith("C")
