"""Check of a coil's voltage spike: its state, and a remedy with the measured values."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from analysis.errors import RecordError
from analysis.waves.coil_spike import EdgeSpike, SpikeSurvey
from analysis.waves.features import ShotFeatures
from daq_service.cli.doctor import spike, trial
from daq_service.settings.tree import Settings
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError
from hardware_drivers.measurement import ShotKey

PLAIN = DaqmxParameters(transducers={"B": TransducerWiring(board_serial="01A2B3C4")})
HELD = replace(PLAIN, holdoff_s=10e-3)
QUIET = SpikeSurvey(
    noise_rms_v=0.03,
    limit_v=0.18,
    wave_v=2.4,
    wave_after_s=32e-3,
    latest_holdoff_s=31.8e-3,
    holdoff_s=10.6e-3,
)
SPIKE = EdgeSpike(height_v=0.8, duration_s=2e-6, ringing_s=12.34e-3, flyback_v=-0.3, triggers=True)


def check(monkeypatch, parameters, found):
    def survey_coil(*_):
        if isinstance(found, Exception):
            raise found
        return found

    monkeypatch.setattr(spike, "strike_and_survey_coil", survey_coil)
    result, survey = spike.strike_and_check_coil(parameters, "B", 1.0)
    assert "nan" not in f"{result}".lower()
    assert survey is (None if isinstance(found, Exception) else found)
    return result


@pytest.mark.parametrize(
    ("parameters", "survey", "state", "remedy"),
    [
        (PLAIN, QUIET, "ok", ""),
        (HELD, QUIET, "ok", ""),
        (PLAIN, replace(QUIET, on=SPIKE), "fail", "holdoff_s = 0.0106, ringing_s = 0 "),
        (HELD, replace(QUIET, on=SPIKE), "ok", ""),
        (
            HELD,
            replace(QUIET, off=SPIKE, holdoff_s=18.8e-3),
            "fail",
            "holdoff_s = 0.0188, ringing_s = 0.0124 ",
        ),
        (replace(HELD, holdoff_s=20e-3), replace(QUIET, off=SPIKE, holdoff_s=18.8e-3), "ok", ""),
        (HELD, replace(QUIET, latest_holdoff_s=9e-3, holdoff_s=3e-3), "fail", "holdoff_s = 0.003"),
        (PLAIN, replace(QUIET, off=SPIKE, trigger_level_v=0.5), "fail", "trigger_level_v = 0.5 "),
        (
            PLAIN,
            replace(QUIET, off=replace(SPIKE, ringing_s=30e-3), holdoff_s=None, obstacle="ringing"),
            "fail",
            "rings for 30 ms and a holdoff ends 31.8 ms after the pulse at the latest: put a flyback diode",
        ),
        (PLAIN, replace(QUIET, holdoff_s=None, obstacle="noise"), "warn", "noise of 0.03 V rms"),
        (
            PLAIN,
            replace(QUIET, wave_v=None, wave_after_s=None, holdoff_s=None, obstacle="no_wave"),
            "warn",
            "whether the striker lifts",
        ),
    ],
)
def test_state_and_remedy_follow_from_spike_and_configuration(monkeypatch, parameters, survey, state, remedy):
    result = check(monkeypatch, parameters, survey)
    assert result.state == state
    assert remedy in result.remedy
    assert bool(remedy) == bool(result.remedy)


def test_each_edge_is_reported_with_the_expected_wave(monkeypatch):
    result = check(monkeypatch, PLAIN, replace(QUIET, off=SPIKE))
    assert result.found == (
        "on: no spike; off: spike 0.8 V for 2 us, rings 12.3 ms, flyback -0.3 V, takes the trigger; the wave "
        "came 32 ms after off with 2.4 V (expected 31.9 ms); trigger level 0.25 V, no holdoff"
    )
    assert result.values["off_height_v"] == 0.8
    assert result.values["expected_wave_after_s"] == pytest.approx(31.93e-3, rel=1e-3)


@pytest.mark.parametrize(
    ("parameters", "error", "state", "area"),
    [
        (PLAIN, ConfigurationError("no route; move the coil"), "warn", "rig"),
        (HELD, ConfigurationError("no route; move the coil"), "fail", "rig"),
        (PLAIN, ConnectionLostError("gone; look"), "fail", "rig"),
        (PLAIN, BusyError("held"), "fail", "recorder"),
        (PLAIN, RecordError("too short: record longer"), "warn", "rig"),
    ],
)
def test_an_error_is_a_check_with_a_remedy(monkeypatch, parameters, error, state, area):
    result = check(monkeypatch, parameters, error)
    assert (result.state, result.area) == (state, area)
    assert result.remedy


@pytest.mark.parametrize(
    ("features", "survey", "state", "message"),
    [
        (ShotFeatures(isw_amplitude_v=2.5), None, "ok", "10% of the incident wave"),
        (ShotFeatures(isw_amplitude_v=0.3), None, "warn", "83% of the incident wave"),
        (ShotFeatures(flags=("missed",), valid=False), None, "skipped", "no incident wave to compare"),
        (ShotFeatures(flags=("false_trigger",), valid=False), QUIET, "ok", "10% of the incident wave"),
        (
            ShotFeatures(flags=("double",), valid=False, isw_amplitude_v=0.3),
            QUIET,
            "ok",
            "10% of the incident wave",
        ),
    ],
)
def test_a_trigger_level_is_checked_against_a_measured_wave(features, survey, state, message):
    shot = SimpleNamespace(key=ShotKey(position="B", set_index=0, shot_index=0))
    result = trial._check_trigger_level(Settings().twin.adc.trigger_level_v, shot, features, survey)
    assert (result.state, message in result.found) == (state, True), result.found
    assert "nan" not in f"{result.found} {result.remedy}".lower()
