"""The pulse-echo unit on the unmodified `niscope` package, a double of NI's library below it."""

import dataclasses

import numpy as np
import pytest
import support.niscope_rig as rig

from hardware_drivers.conformance.pulse_echo_unit_contract import PulseEchoUnitContract
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
)
from hardware_drivers.instruments import SelfCalibrating
from hardware_drivers.measurement import ShotKey
from hardware_drivers.niscope.parameters import NiscopeParameters, ProbeWiring
from hardware_drivers.niscope.pulse_echo import open_niscope
from simulator.doubles.chassis.description import ProbeWiring as DoubleProbe
from simulator.doubles.chassis.scopes import ScopeParameters
from simulator.parameters.experiment import EchoParameters

pytestmark = rig.needs_niscope


@pytest.fixture
def brain():
    with rig.met_brain(rig.description()) as brain:
        yield brain
        assert brain.record()["sessions"] == []
        assert brain.record()["leaked"] == []


@pytest.fixture
def unit(brain):
    with open_niscope(rig.parameters()) as unit:
        yield unit


class TestNiscopePulseEchoUnit(PulseEchoUnitContract):
    @pytest.fixture
    def pulse_echo(self, unit):
        return unit

    @pytest.fixture
    def keys(self):
        return rig.key(0), rig.key(1)

    @pytest.fixture
    def unknown_key(self):
        return ShotKey(position="nowhere", set_index=0, shot_index=0)


def test_the_sum_of_the_records_is_the_twin_s_echo_to_the_last_count(unit, brain):
    brain.announce(rig.key(), rig.HOUR_H)
    waveform = unit.acquire(rig.key(), rig.TIMEOUT_S).waveform
    described = rig.description()
    codes = rig.codes_of_the_twin(described, rig.key())
    # 16 equal records of codes padded by 4.
    np.testing.assert_array_equal(waveform.counts, 16 * 4 * codes.astype(np.int32))
    # 64 is a power of two: the volts are those of one code through the board's scaling, bit for bit.
    np.testing.assert_array_equal(waveform.volts(), rig.SCOPE.calibration(1.0, 0.0).volts(codes))
    assert waveform.counts.dtype == np.int32


def test_a_record_stores_its_acquisition_settings(unit):
    settings = unit.acquire(rig.key(), rig.TIMEOUT_S).settings
    assert settings["board_serial"] == "01C5A1F0"
    assert settings["product"] == "NI PXI-5122"
    assert settings["calibration_date"] == "2026-05-04"
    assert settings["calibration_temperature_c"] == 41.5
    assert (settings["clipped_records"], settings["first_sample_s"]) == (0.0, 0.0)
    assert settings["trigger_level_v"] == 1.0
    assert "driver_warnings" not in settings
    assert all(isinstance(value, float | str) for value in settings.values())
    assert unit.identity() == {
        "niscope": settings["niscope_version"],
        "ni_scope": settings["driver_version"],
        "probe_A": "NI PXI-5122 01C5A1F0 at PXI1Slot5, channel 0",
    }


def test_clipping_is_counted_on_the_single_records():
    loud = dataclasses.replace(rig.QUIET, echo=EchoParameters(back_wall_v=30.0))
    with rig.met_brain(rig.description(twin=loud)), open_niscope(rig.parameters()) as unit:
        settings = unit.acquire(rig.key(), rig.TIMEOUT_S).settings
    assert settings["clipped_records"] == 16.0
    assert "ADC overload" in settings["driver_warnings"]


def test_a_session_is_set_up_once_and_then_only_triggered(unit, brain):
    unit.acquire(rig.key(0), rig.TIMEOUT_S)
    brain.clear_record()
    unit.acquire(rig.key(1), rig.TIMEOUT_S)
    called = set(rig.functions_of(brain.record()))
    assert "niScope_FetchBinary16" in called
    assert not {name for name in called if "Configure" in name or "Commit" in name or "Init" in name} - {
        "niScope_InitiateAcquisition"
    }


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"range_v": 0.3}, r"range_v is 0\.3; the NI PXI-5122 at 'PXI1Slot5' would use 0\.5"),
        ({"channel": "7"}, "channel is '7'; the NI PXI-5122 at 'PXI1Slot5' has 0, 1"),
        ({"range_v": 50.0}, "NI-SCOPE error -1074135024"),
        ({"resource": "PXI1Slot9"}, "'PXI1Slot9'(.|\n)*NI-SCOPE error -1074134944"),
        ({"serial_number": "0BADCAFE"}, "'PXI1Slot5' is a NI PXI-5122 with serial number '01C5A1F0', not"),
    ],
)
def test_an_unsupported_setting_is_refused_at_the_start(brain, changes, message):
    with pytest.raises(ConfigurationError, match=message), open_niscope(rig.parameters(**changes)):
        pytest.fail("it opened")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sample_rate_hz": 60e6}, r"sample_rate_hz is 60000000\.0; .* would use 100000000\.0"),
        ({"sample_rate_hz": 200e6}, "NI-SCOPE error"),
        ({"record_samples": 5_000_000}, "NI-SCOPE error -1074118653"),
    ],
)
def test_an_unsupported_record_is_refused_at_the_start(brain, changes, message):
    asked = dataclasses.replace(rig.parameters(), **changes)
    with pytest.raises(ConfigurationError, match=message), open_niscope(asked):
        pytest.fail("it opened")


def test_no_wait_is_longer_than_configured():
    short = dataclasses.replace(rig.parameters(), call_timeout_s=0.01)
    with (
        rig.met_brain(rig.description(switched_on=False)),
        open_niscope(short) as unit,
        pytest.raises(AcquisitionTimeoutError, match="its sync reaches the trigger input") as late,
    ):
        unit.acquire(rig.key(), 20.0)
    assert "Timeout: 0.01 s" in str(late.value)


@pytest.mark.parametrize(("source", "terminal"), [("external", "VAL_EXTERNAL"), ("pfi_1", "VAL_PFI_1")])
def test_time_zero_is_the_firing_pulse_however_late_it_comes_after_the_sync(source, terminal):
    described = rig.description(sync_terminal=terminal, sync_to_firing_s=3e-6)
    wired = rig.parameters(trigger_source=source, firing_delay_s=3e-6)
    with rig.met_brain(described) as brain, open_niscope(wired) as unit:
        brain.announce(rig.key(), rig.HOUR_H)
        echo = unit.acquire(rig.key(), rig.TIMEOUT_S)
    codes = rig.codes_of_the_twin(described, rig.key())
    np.testing.assert_array_equal(echo.waveform.counts, 64 * codes.astype(np.int32))
    assert echo.settings["first_sample_s"] == 3e-6


def test_a_board_of_another_process_is_named_and_not_touched(brain):
    brain.occupy(rig.RESOURCE, "InstrumentStudio of pc-7")
    with (
        pytest.raises(BusyError, match="being used by another application or process"),
        open_niscope(rig.parameters()),
    ):
        pytest.fail("it opened")
    assert "niScope_ResetDevice" not in rig.functions_of(brain.record())
    brain.vacate("InstrumentStudio of pc-7")
    with open_niscope(rig.parameters()) as unit:
        unit.acquire(rig.key(), rig.TIMEOUT_S)


@pytest.mark.parametrize("label", ["01C5A1F0", "1c5a1f0", " 01c5a1f0 ", ""])
def test_a_serial_number_is_read_as_labels_print_it(brain, label):
    with open_niscope(rig.parameters(serial_number=label)) as unit:
        assert unit.acquire(rig.key(), rig.TIMEOUT_S).settings["board_serial"] == "01C5A1F0"


def test_two_probes_take_turns_on_one_board():
    described = rig.description()
    probes = {
        name: DoubleProbe(resource=rig.RESOURCE, channel=channel)
        for name, channel in (("A", "0"), ("E", "1"))
    }
    described = dataclasses.replace(described, probes=probes)
    wiring = {
        name: ProbeWiring(resource=rig.RESOURCE, channel=probe.channel) for name, probe in probes.items()
    }
    with rig.met_brain(described) as running, open_niscope(NiscopeParameters(probes=wiring)) as unit:
        for name in ("A", "E", "E", "A"):
            shot = ShotKey(position=name, set_index=7, shot_index=0)
            running.announce(shot, rig.HOUR_H)
            echo = unit.acquire(shot, rig.TIMEOUT_S)
            assert echo.settings["channel"] == wiring[name].channel
            assert np.ptp(echo.waveform.counts) > 0
        assert len(running.record()["sessions"]) == 1


def test_self_calibration_is_dated_and_the_next_record_is_configured_again(unit, brain):
    assert isinstance(unit, SelfCalibrating)
    done = unit.self_calibrate()
    assert list(done) == ["01C5A1F0"]
    assert done["01C5A1F0"].endswith(", 41.50 C")
    assert unit.acquire(rig.key(), rig.TIMEOUT_S).settings["calibration_date"] in done["01C5A1F0"]
    called = rig.functions_of(brain.record())
    assert "niScope_Commit" in called[called.index("niScope_CalSelfCalibrate") :]


def test_a_board_that_was_unplugged_is_found_again_under_another_name():
    looked_for = rig.parameters(other_resources=("Dev3", "Dev4"))
    with rig.met_brain(rig.description()) as running, open_niscope(looked_for) as unit:
        unit.acquire(rig.key(), rig.TIMEOUT_S)
        running.unplug(rig.SERIAL)
        for attempts in (None, None, None, 3, 4):
            message = f"not back after {attempts} attempts" if attempts else "."
            with pytest.raises(ConnectionLostError, match=message):
                unit.acquire(rig.key(), rig.TIMEOUT_S)
        running.plug(rig.SERIAL, "Dev4")
        assert unit.acquire(rig.key(), rig.TIMEOUT_S).settings["resource"] == "Dev4"
        # The recovery starts again: one loss is no reason for a reset.
        running.clear_record()
        running.faults.inject("niScope_InitiateAcquisition", "error", code=-1074118654)
        with pytest.raises(ConnectionLostError):
            unit.acquire(rig.key(), rig.TIMEOUT_S)
        unit.acquire(rig.key(), rig.TIMEOUT_S)
        assert "niScope_ResetDevice" not in rig.functions_of(running.record())


def test_another_board_under_the_name_is_never_reset():
    described = rig.description()
    stranger = ScopeParameters(name="Dev3", serial_number=0x0BADCAFE)
    described = dataclasses.replace(described, scopes=(rig.SCOPE, stranger))
    looked_for = rig.parameters(other_resources=("Dev3",))
    with rig.met_brain(described) as running, open_niscope(looked_for) as unit:
        running.unplug(rig.SERIAL)
        running.clear_record()
        for _ in range(5):
            with pytest.raises(ConnectionLostError):
                unit.acquire(rig.key(), rig.TIMEOUT_S)
        called = rig.functions_of(running.record())
        assert "niScope_InitWithOptions" in called
        assert "niScope_ResetDevice" not in called
        assert running.record()["sessions"] == []


def test_the_second_rung_resets_our_own_board(unit, brain):
    unit.acquire(rig.key(), rig.TIMEOUT_S)
    brain.clear_record()
    brain.faults.inject("niScope_InitiateAcquisition", "error", code=-1074118654, times=2)
    for _ in range(2):
        with pytest.raises(ConnectionLostError):
            unit.acquire(rig.key(), rig.TIMEOUT_S)
    unit.acquire(rig.key(), rig.TIMEOUT_S)
    assert rig.functions_of(brain.record()).count("niScope_ResetDevice") == 1


def test_without_ni_tclk_no_board_is_opened(brain, monkeypatch):
    import nitclk

    def missing(_handle):
        raise nitclk.errors.DriverNotInstalledError

    monkeypatch.setattr(nitclk, "SessionReference", missing)
    brain.clear_record()
    with pytest.raises(ConfigurationError, match="NI-TClk"), open_niscope(rig.parameters()):
        pytest.fail("it opened")
    assert rig.functions_of(brain.record()) == []
