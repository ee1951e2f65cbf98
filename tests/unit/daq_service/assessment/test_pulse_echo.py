"""From an echo to a row: no value without a back wall, clipping flagged, V-path corrected."""

from dataclasses import replace

import numpy as np
import pytest
from support.small_experiment import small_settings

from daq_service.assessment.pulse_echo import PulseEchoAssessor
from hardware_drivers.measurement import DueSet, PulseEchoRecord, ShotKey, Stamp, Waveform
from simulator.echo.pulse import build_echo_calibration, simulate_echo
from simulator.electronics.transduction import quantise_volts
from simulator.parameters.echo import EchoParameters

STRAIGHT = EchoParameters(
    element_separation_m=0.0, roughness_fraction=0.0, velocity_per_k=0.0, bubble_probability=0.0
)
CALIBRATION = build_echo_calibration(STRAIGHT)


def assessor(**ultrasound):
    return PulseEchoAssessor("A", small_settings(ultrasound=ultrasound))


def assess(made, volts, sequence=1, settings=None):
    echo = PulseEchoRecord(
        sequence=sequence,
        key=ShotKey(position="A", set_index=sequence, shot_index=0),
        stamp=Stamp(utc_ns=0, mono_ns=0, boot_id="x"),
        waveform=Waveform(
            counts=quantise_volts(volts, CALIBRATION),
            sample_rate_hz=1e8,
            pretrigger_samples=0,
            calibration=CALIBRATION,
        ),
        gain_db=30.0,
        offset_v=0.0,
        averages=16,
        settings=settings or {},
    )
    return made.assess(DueSet(set_index=sequence, due_h=float(sequence), due_utc_ns=0), echo)


def test_a_thinned_wall_is_a_row_with_its_interval_in_the_alarm_s_proof():
    made = assessor()
    assess(made, simulate_echo(6.35e-3, STRAIGHT))
    found = assess(made, simulate_echo(4.2e-3, STRAIGHT), sequence=2)
    (row,) = found.thickness
    assert row.thickness_m == pytest.approx(4.2e-3, abs=1e-6)
    assert row.quality == "good"
    assert found.shot_flags == {2: ()}
    evidence = found.conditions[0].evidence
    low_m, high_m = evidence["interval_m"]
    assert low_m < 4.2e-3 < high_m
    assert high_m - low_m < 0.1e-3
    assert evidence["roughness_rms_m"] < 0.05e-3


def test_without_a_back_wall_there_is_a_flag_and_no_thickness():
    made = assessor()
    assess(made, simulate_echo(6.35e-3, STRAIGHT))
    noise_v = 2.5e-3 * np.random.default_rng(1).standard_normal(2_048)
    found = assess(made, noise_v, sequence=2)
    (row,) = found.thickness
    assert row.quality == "bad"
    assert (row.travel_time_s, row.thickness_m, row.thickness_loss_m) == (None, None, None)
    assert found.shot_flags == {2: ("no_echo",)}
    assert (found.n_valid, found.invalid) == (0, frozenset({2}))
    assert found.conditions[0].evidence["thickness_m"] is None
    assert found.conditions[0].evidence["interval_m"] is None


@pytest.mark.parametrize(
    ("gain", "settings"), [(1.0, {"clipped_records": 1.0}), (4.0, {"clipped_records": 16.0}), (4.0, {})]
)
def test_clipping_is_flagged_with_and_without_an_instrument_flag(gain, settings):
    made = assessor()
    assess(made, simulate_echo(6.35e-3, STRAIGHT))
    found = assess(made, gain * simulate_echo(5e-3, STRAIGHT), sequence=2, settings=settings)
    (row,) = found.thickness
    assert found.shot_flags == {2: ("clipped",)}
    assert row.quality == "suspect"
    assert found.n_valid == 1
    assert row.thickness_m == pytest.approx(5e-3, abs=5e-6)  # clipping is symmetric
    assert "clipped" in found.note


def test_a_known_element_separation_is_corrected():
    echo = replace(STRAIGHT, element_separation_m=2.7e-3)
    read_m = {}
    for known_m in (0.0, 2.7e-3):
        made = assessor(element_separation_m=known_m)
        assess(made, simulate_echo(6.35e-3, echo))
        (row,) = assess(made, simulate_echo(3.8e-3, echo), sequence=2).thickness
        read_m[known_m] = row.thickness_m
        assert row.thickness_m + row.thickness_loss_m == pytest.approx(6.35e-3, rel=1e-12)
    assert read_m[2.7e-3] == pytest.approx(3.8e-3, abs=1e-6)
    assert read_m[0.0] == pytest.approx(3.945e-3, abs=1e-6)


@pytest.mark.parametrize(
    ("minimum_wall_m", "limit_m", "exceeds"),
    [(None, 5.715e-3, False), (5.5e-3, 5.715e-3, False), (6e-3, 6e-3, True)],
)
def test_the_larger_of_both_limits_raises_the_alarm(minimum_wall_m, limit_m, exceeds):
    made = PulseEchoAssessor(
        "A", small_settings(positions={"A": {"method": "pulse_echo", "minimum_wall_m": minimum_wall_m}})
    )
    assess(made, simulate_echo(6.35e-3, STRAIGHT))
    found = assess(made, simulate_echo(5.9e-3, STRAIGHT), sequence=2)
    assert made.exceeds_limit(found.thickness[0]) is exceeds
    assert found.conditions[0].evidence["limit_m"] == pytest.approx(limit_m)
    assert (found.conditions[0].times_limit > 1.0) is exceeds


@pytest.mark.parametrize(
    ("interval_high_m", "exceeds"),
    [(5.7e-3, True), (5.73e-3, None), (None, True)],
    ids=["below", "over", "old"],
)
def test_a_reading_counts_when_its_complete_interval_is_below_the_limit(interval_high_m, exceeds):
    made = assessor()
    assess(made, simulate_echo(6.35e-3, STRAIGHT))
    (row,) = assess(made, simulate_echo(5.65e-3, STRAIGHT), sequence=2).thickness
    assert row.interval_high_m == pytest.approx(5.65e-3, abs=0.05e-3)
    reading = replace(row, interval_high_m=interval_high_m)
    assert made.exceeds_limit(reading) is exceeds
    for _ in range(3):
        made.add(reading)
    assert made.state.alarm.active is bool(exceeds)


def test_wide_intervals_do_not_clear_the_alarm_of_a_thin_wall():
    made = assessor()
    assess(made, simulate_echo(6.35e-3, STRAIGHT))
    (thin,) = assess(made, simulate_echo(5.5e-3, STRAIGHT), sequence=2).thickness
    (sound,) = assess(made, simulate_echo(6.2e-3, STRAIGHT), sequence=3).thickness
    wide = replace(thin, interval_high_m=6.1e-3)
    for reading, active in ((thin, True), (wide, True), (sound, False)):
        for _ in range(5):
            made.add(reading)
        assert made.state.alarm.active is active
