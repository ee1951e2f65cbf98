"""Tests beyond solimon's suites: this oscilloscope's codes, statuses and losses."""

from ctypes import c_int16
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from block_scope import api
from block_scope.api import Status
from block_scope.double import SERIAL, WAVE_RATE_HZ, ScopeDouble, as_library, pulse_v
from block_scope.kind import KIND, BlockScopeParameters
from pydantic import ValidationError

from hardware_drivers.conformance.bench import MachineClock
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
)
from hardware_drivers.kinds import Opening
from hardware_drivers.measurement import ShotKey

KEY = ShotKey(position="B", set_index=0, shot_index=0)
OPENING = Opening(clock=MachineClock(), serves={"digitizer": ("B",)})
TIMEOUT_S = 10.0


@pytest.fixture
def scope(monkeypatch):
    scope = ScopeDouble()
    monkeypatch.setattr(api, "load", lambda name: as_library(scope))
    return scope


def opened(**parameters: Any):
    return KIND.open(BlockScopeParameters(channels={"B": "A"}, **parameters), OPENING)


def take(digitizer, scope, volts_v):
    digitizer.arm(KEY)
    scope.wave_arrives(volts_v, WAVE_RATE_HZ)
    return digitizer.read(TIMEOUT_S)


@pytest.mark.parametrize("bits", [8, 12, 14, 16])
def test_volts_are_those_at_the_input_within_half_a_code(scope, bits):
    volts_v = pulse_v()
    with opened(resolution_bits=bits) as instruments:
        waveform = take(instruments.digitizer, scope, volts_v).waveform
    code_v = 5.0 / (2 ** (bits - 1) - 1)
    # The record begins with the samples before the trigger: the first that reaches the level, as rounded.
    at_input_v = volts_v[:: round(WAVE_RATE_HZ / 10e6)]
    trigger = int(np.argmax(np.rint(at_input_v / code_v) >= round(0.25 / code_v)))
    recorded_v = waveform.volts()[1_000 - trigger :][: at_input_v.size]
    assert np.abs(recorded_v - at_input_v[: recorded_v.size]).max() <= 0.5001 * code_v
    assert waveform.counts.size == 13_600
    assert not waveform.clipped


def test_a_wave_that_exceeds_the_range_is_clipped_and_reported(scope):
    with opened(range_v=2.0) as instruments:
        acquired = take(instruments.digitizer, scope, pulse_v(peak_v=3.0))
    assert acquired.waveform.clipped
    assert acquired.settings["left_its_range"] == "yes"


def test_a_falling_slope_takes_the_other_sign(scope):
    with opened(trigger_slope="falling", trigger_level_v=-0.25) as instruments:
        acquired = take(instruments.digitizer, scope, -pulse_v())
    assert acquired.waveform.volts()[1_000] <= -0.25
    assert acquired.waveform.volts()[999] > -0.25


def test_the_next_shot_opens_the_unit_again_after_it_was_unplugged(scope):
    with opened() as instruments:
        first = take(instruments.digitizer, scope, pulse_v())
        instruments.digitizer.arm(KEY)
        scope.unplug()
        with pytest.raises(ConnectionLostError, match="NOT_RESPONDING"):
            instruments.digitizer.read(TIMEOUT_S)
        scope.plugged_in = True
        second = take(instruments.digitizer, scope, pulse_v())
    np.testing.assert_array_equal(first.waveform.counts, second.waveform.counts)


def test_an_old_handle_is_a_lost_connection(scope):
    with opened() as instruments:
        instruments.digitizer.arm(KEY)
        scope.unplug()
        scope.plugged_in = True
        with pytest.raises(ConnectionLostError, match="INVALID_HANDLE"):
            instruments.digitizer.read(TIMEOUT_S)


def test_a_unit_that_another_program_uses_is_busy(scope):
    scope.opened_elsewhere = True
    with pytest.raises(BusyError, match="close the other program"), opened():
        pytest.fail("it was opened")
    (finding,) = KIND.check(BlockScopeParameters(channels={"B": "A"}), OPENING)
    assert (finding.state, finding.held) == ("fail", True)


def test_a_unit_still_at_work_is_busy(scope):
    with opened() as instruments:
        instruments.digitizer.arm(KEY)
        with patch.object(scope, "bs_stop", lambda handle: Status.OK):
            instruments.digitizer.disarm()
        with pytest.raises(BusyError, match="bs_run_block says BUSY"):
            instruments.digitizer.arm(KEY)


def test_the_error_shows_the_code_of_an_unknown_status(scope):
    with opened() as instruments, patch.object(scope, "bs_run_block", lambda *arguments: 0x1234):
        with pytest.raises(ConfigurationError, match="status 0x1234"):
            instruments.digitizer.arm(KEY)


def test_missing_samples_are_an_error(scope):
    real = scope.bs_get_values

    def short(handle, buffer, n_samples, overflow):
        status = real(handle, buffer, n_samples, overflow)
        n_samples.contents.value -= 1
        return status

    with opened() as instruments, patch.object(scope, "bs_get_values", short):
        with pytest.raises(ConnectionLostError, match="13599 of 13600"):
            take(instruments.digitizer, scope, pulse_v())


def test_a_wait_polls_rarely(scope, monkeypatch):
    polls, now_s = [], [0.0]
    monkeypatch.setattr("block_scope.unit.time.monotonic", lambda: now_s[0])

    def sleep(seconds):
        now_s[0] += seconds

    def is_ready(handle, ready):
        polls.append(now_s[0])
        return ScopeDouble.bs_is_ready(scope, handle, ready)

    monkeypatch.setattr("block_scope.unit.time.sleep", sleep)
    monkeypatch.setattr(scope, "bs_is_ready", is_ready)
    with opened() as instruments:
        instruments.digitizer.arm(KEY)
        with pytest.raises(AcquisitionTimeoutError, match="no trigger within 1 s"):
            instruments.digitizer.read(1.0)
    # Each 2 ms, and once at the end.
    assert len(polls) in (501, 502)
    assert now_s[0] == pytest.approx(1.0)


def test_a_rate_that_would_be_rounded_is_refused(scope):
    with pytest.raises(ConfigurationError, match=r"sample_rate_hz is 9\.6e\+06; the nearest .* is 1e\+07"):
        with opened(sample_rate_hz=9.6e6):
            pytest.fail("it was opened")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"record_samples": 500}, "pretrigger_samples is 1000"),
        ({"range_v": 3.0}, "range_v is 3.0; the oscilloscope has"),
        ({"trigger_level_v": 6.0}, "trigger_level_v is 6.0"),
        ({"channels": {}}, "channels"),
    ],
)
def test_parameters_that_do_not_fit_each_other_are_refused(given, message):
    with pytest.raises(ValidationError, match=message):
        BlockScopeParameters(**{"channels": {"B": "A"}, **given})


def test_a_position_without_an_input_is_refused_when_the_configuration_is_read():
    with pytest.raises(ValueError, match="channels has no 'C'"):
        KIND.require(BlockScopeParameters(channels={"B": "A"}), {"digitizer": ("C",)})


def test_the_identity_is_reported(scope):
    with opened(serial=SERIAL) as instruments:
        assert instruments.identity["serial"] == SERIAL
    (finding,) = KIND.check(BlockScopeParameters(channels={"B": "A"}), OPENING)
    assert finding.state == "ok"
    assert SERIAL in finding.detail


def test_the_error_names_a_missing_library():
    with pytest.raises(ConfigurationError, match="no-such-library"):
        api.load("no-such-library")


def test_the_double_has_the_library_s_functions():
    assert {name for name in dir(ScopeDouble) if name.startswith("bs_")} == set(api.PROTOTYPES)
    assert ScopeDouble().bs_maximum_value(7, c_int16()) == Status.INVALID_HANDLE
