"""What no double can prove of NI-SCOPE boards: records of a pulser that fires by itself, noise and scale.

Nothing is switched or fired: the pulser-receiver is on, its probe on the specimen.
"""

from dataclasses import replace
from datetime import date, datetime, timedelta

import numpy as np
import pytest

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.measurement import ShotKey
from hardware_drivers.niscope.pulse_echo import open_niscope

FEW, MANY = 1, 16
PARTS = 16
"""Of a record: the median over them says what noise is where no echo trembles."""
WIDER = (2.0, 2.5, 4.0, 5.0)
"""Ratios of neighbouring ranges of NI's boards."""
GAIN_ERROR = 0.02
"""Far beyond a board's own (PXI-5122: 0.65 %), far below a wrong scale."""


def echoes(parameters, position, number):
    """Return consecutive records."""
    with open_niscope(replace(parameters, probes={position: parameters.probes[position]})) as unit:
        return [
            unit.acquire(ShotKey(position=position, set_index=index, shot_index=0), parameters.call_timeout_s)
            for index in range(number)
        ]


def volts(echo):
    """Return a record in V."""
    return np.asarray(echo.waveform.volts(), dtype=np.float64)


def noise_v(one, other):
    """Return the standard deviation from the difference of two records, in their quieter half."""
    parts = np.array_split(volts(one) - volts(other), PARTS)
    return float(np.median([part.std() for part in parts])) / np.sqrt(2.0)


def test_records_come_whole_at_the_asked_rate_and_range(probe_parameters):
    for position, wiring in probe_parameters.probes.items():
        one, other = echoes(probe_parameters, position, 2)
        for echo in (one, other):
            assert echo.waveform.counts.size == probe_parameters.record_samples
            assert echo.waveform.sample_rate_hz == pytest.approx(probe_parameters.sample_rate_hz, rel=1e-6)
            assert (echo.averages, echo.gain_db) == (probe_parameters.averages, wiring.gain_db)
            assert echo.settings["range_v"] == wiring.range_v
            assert echo.settings["clipped_records"] == 0.0, f"{position}: lower the gain, or widen range_v"
            assert np.abs(volts(echo) - echo.offset_v).max() > 0.05 * wiring.range_v, f"{position}: an echo"
        assert not np.array_equal(one.waveform.counts, other.waveform.counts), "a buffer handed over twice"


def test_averaging_lets_noise_fall_with_the_root_of_the_number(probe_parameters):
    for position in probe_parameters.probes:
        found = {}
        for averages in (FEW, MANY):
            one, other = echoes(replace(probe_parameters, averages=averages), position, 2)
            found[averages] = noise_v(one, other)
        step_v = float(one.settings["record_gain_v_per_count"])
        if found[FEW] < step_v:
            pytest.skip(f"{position}: the noise is below one code, which averaging cannot make smaller")
        # A standard deviation of some hundred samples is known to some per cent, a drift of the gain beside.
        assert found[FEW] / found[MANY] == pytest.approx((MANY / FEW) ** 0.5, rel=0.35), position


def test_a_wider_range_has_a_larger_step_and_the_same_volts(probe_parameters):
    for position, wiring in probe_parameters.probes.items():
        (narrow,) = echoes(probe_parameters, position, 1)
        for ratio in WIDER:
            widened = replace(wiring, range_v=ratio * wiring.range_v)
            try:
                (wide,) = echoes(replace(probe_parameters, probes={position: widened}), position, 1)
            except ConfigurationError:
                continue  # not one of this board's ranges
            break
        else:
            pytest.skip(f"{position}: this board has no range of {WIDER} times {wiring.range_v} V")
        steps = [float(echo.settings["record_gain_v_per_count"]) for echo in (narrow, wide)]
        assert steps[1] / steps[0] == pytest.approx(ratio, rel=GAIN_ERROR)
        peak_v = float(np.abs(volts(narrow)).max())
        # Six times the noise of the difference covers its largest sample.
        slack_v = GAIN_ERROR * peak_v + 6.0 * max(noise_v(narrow, wide), steps[1])
        assert np.abs(volts(wide) - volts(narrow)).max() < slack_v, position


def test_self_calibration_is_dated_today(probe_parameters):
    for position, wiring in probe_parameters.probes.items():
        with open_niscope(replace(probe_parameters, probes={position: wiring})) as unit:
            done = unit.self_calibrate()
            key = ShotKey(position=position, set_index=0, shot_index=0)
            calibration_date = str(
                unit.acquire(key, probe_parameters.call_timeout_s).settings["calibration_date"]
            )
        assert len(done) == 1
        # The board's date is that of the computer, in UTC or in local time.
        assert abs(
            date.fromisoformat(calibration_date[:10]) - datetime.now().astimezone().date()
        ) <= timedelta(days=1)
