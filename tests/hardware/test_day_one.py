"""What no double can prove: this chassis, its comparator, routes, memory transfers and watchdog.

Run with ``pytest -m hardware``; ``docs/how-to/set-up-a-rig.md`` lists what to wire and to switch off.
Most tests move nothing; those that lift strikers or need a wire state it in their reason for a skip.
"""

from contextlib import closing
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest
from looped_coil import AFTER_S, LOOPBACK_PRETRIGGER, LOOPBACK_RATE_HZ

from analysis.waves.features import extract_features
from daq_service.cli.doctor.spike import strike_and_check_coil
from hardware_drivers.daqmx.acquisition import commit_acquisition
from hardware_drivers.daqmx.boards import find_boards, normalize_serial
from hardware_drivers.daqmx.coil import commit_coil
from hardware_drivers.daqmx.connection import Connection
from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.daqmx.look import find_digital_line
from hardware_drivers.daqmx.survey import survey_rig
from hardware_drivers.errors import AcquisitionTimeoutError
from hardware_drivers.measurement import ShotKey

TTL_LOW_V, TTL_HIGH_V = 0.8, 2.0
"""Levels of TTL inputs, which the coil driver's input obeys."""
READ_TIMEOUT_S = 5.0
RECORDS = 300
"""More than a set of ten strikes at three transducers, ten times over."""


# Nothing moves --------------------------------------------------------------------------------------


def test_the_boards_use_the_configured_wiring(parameters):
    failed = [finding for finding in survey_rig(parameters).findings if finding.state == "fail"]
    assert failed == []


def test_the_coils_lines_power_up_low(parameters):
    """X Series keep a power-up state for each line; the others need the resistor of the wiring page."""
    from nidaqmx.constants import PowerUpStates
    from nidaqmx.system import System

    if parameters.transport == "grpc":
        pytest.skip("power-up states are read at the chassis itself")
    lines = {
        (normalize_serial(wiring.coil_serial), find_digital_line(wiring.output_terminal))
        for wiring in parameters.transducers.values()
    }
    if not all(line for _, line in lines):
        pytest.skip("a coil leaves its board at a terminal that has no digital line")
    connection = Connection(parameters)
    try:
        boards = find_boards(connection, {serial for serial, _ in lines})
        for serial, line in lines:
            states = {
                state.physical_channel.removeprefix(f"{boards[serial].name}/"): state.power_up_state
                for state in System.local().get_digital_power_up_states(boards[serial].name)
            }
            # High impedance is low only with a pull-down, which no software can see.
            assert states[line] in (PowerUpStates.LOW, PowerUpStates.TRISTATE), (serial, line)
    finally:
        connection.close()


def test_records_at_the_asked_rate_come_whole_one_after_the_other(parameters):
    """Memory transfers at full rate: an overflow or a lost sample is an error of the read."""
    rehearsal = replace(parameters, dry_run=True)
    with open_daqmx(rehearsal) as rig:
        for number in range(RECORDS):
            position = list(parameters.transducers)[number * len(parameters.transducers) // RECORDS]
            rig.digitizer.arm(ShotKey(position=position, set_index=0, shot_index=number))
            waveform = rig.digitizer.read(READ_TIMEOUT_S).waveform
            assert waveform.counts.size == parameters.record_samples
            assert waveform.sample_rate_hz == pytest.approx(parameters.sample_rate_hz, rel=1e-6)


def test_noise_differs_from_record_to_record(parameters):
    """A buffer handed over twice would look like a quiet input."""
    position = next(iter(parameters.transducers))
    seen = []
    with open_daqmx(replace(parameters, dry_run=True)) as rig:
        for number in range(2):
            rig.digitizer.arm(ShotKey(position=position, set_index=0, shot_index=number))
            seen.append(rig.digitizer.read(READ_TIMEOUT_S).waveform.counts)
    assert not np.array_equal(*seen)


def test_self_calibration_is_dated_today_and_leaves_the_scaling_sound(parameters):
    with open_daqmx(replace(parameters, dry_run=True)) as rig:
        done = rig.self_calibrating.self_calibrate()
        position = next(iter(parameters.transducers))
        rig.digitizer.arm(ShotKey(position=position, set_index=0, shot_index=0))
        acquired = rig.digitizer.read(READ_TIMEOUT_S)
    assert set(done) == {normalize_serial(wiring.board_serial) for wiring in parameters.transducers.values()}
    calibration_date = str(acquired.settings["calibration_date"])
    if not calibration_date:
        pytest.skip(f"this board does not calibrate itself: {done}")
    # The board's clock is that of the driver's computer; an hour allows for a remote chassis.
    assert abs(
        datetime.fromisoformat(calibration_date).astimezone() - datetime.now().astimezone()
    ) < timedelta(hours=1)
    # An open or quiet input lies within a hundredth of its range.
    assert abs(float(np.mean(acquired.waveform.volts()))) < 0.01 * acquired.waveform.calibration.range_v


# Strikers move --------------------------------------------------------------------------------------


def one_shot(parameters, position):
    """Return the record of one strike through the driver's own instruments: arm, strike, read."""
    key = ShotKey(position=position, set_index=0, shot_index=0)
    with open_daqmx(parameters) as rig:
        rig.digitizer.arm(key)
        rig.striker.strike(key)
        return rig.digitizer.read(READ_TIMEOUT_S).waveform


@pytest.mark.usefixtures("may_strike")
def test_each_striker_makes_a_wave_that_passes_its_own_trigger(parameters):
    """The comparator's level against the ADC's: the driver refuses a record that does not pass it there."""
    for position, wiring in parameters.transducers.items():
        waveform = one_shot(parameters, position)
        volts = waveform.volts()
        before = volts[: waveform.pretrigger_samples // 2]
        level_v = abs(parameters.trigger_level_v)
        assert np.abs(before).max() < level_v, f"{position}: quiet before the wave"
        assert np.abs(volts).max() > 2.0 * level_v, f"{position}: a wave, not noise at the level"
        assert not waveform.clipped, f"{position}: within +-{wiring.range_v} V"


# A wire from a coil's output to an input ------------------------------------------------------------


def high_s(waveform):
    """Return how long the line is high in a record with one pulse."""
    high = np.flatnonzero(waveform.volts() > TTL_HIGH_V)
    assert high.size, "the line never went high"
    assert high[-1] - high[0] + 1 == high.size, "one pulse without a gap"
    return float(high.size / waveform.sample_rate_hz)


def commit_shot(loopback, record):
    """Return a committed acquisition of the looped input by its own board."""
    return commit_acquisition(
        loopback.connection,
        loopback.parameters,
        loopback.position,
        loopback.board,
        loopback.board,
        record=record,
    )


def noise_while(loopback, act=lambda: None):
    """Return the volts of a record without a trigger that has started before something is done."""
    with closing(commit_shot(loopback, "noise")) as acquisition:
        acquisition.start()
        act()
        return acquisition.read(READ_TIMEOUT_S).volts()


def test_the_coil_is_on_for_exactly_its_pulse(loopback):
    waveform = one_shot(loopback.parameters, loopback.position)
    volts = waveform.volts()
    # Both ends fall between two samples; the counter runs on the clock that times the samples.
    assert high_s(waveform) == pytest.approx(loopback.parameters.pulse_s, abs=2.0 / LOOPBACK_RATE_HZ)
    assert np.abs(volts[: LOOPBACK_PRETRIGGER - 2]).max() < TTL_LOW_V, "low before"
    after = volts[-round(0.5 * AFTER_S * LOOPBACK_RATE_HZ) :]
    assert np.abs(after).max() < TTL_LOW_V, "low after"


@pytest.mark.parametrize("level_v", [0.5, 1.0, 2.0])
def test_the_comparator_triggers_at_levels_within_the_pulse(loopback, level_v):
    volts = one_shot(loopback.at_level(level_v), loopback.position).volts()
    assert volts[LOOPBACK_PRETRIGGER - 3] < level_v < volts[LOOPBACK_PRETRIGGER + 3]


def test_the_comparator_does_not_trigger_above_the_pulse(loopback):
    with pytest.raises(AcquisitionTimeoutError):
        one_shot(loopback.at_level(8.0), loopback.position)


def test_the_board_starts_with_the_coil_s_counter_and_delays_by_what_is_asked(loopback):
    """The route and the delay that a holdoff is made of: started by the pulse, delayed by half of it."""
    from nidaqmx.constants import DigitalWidthUnits

    parameters, board = loopback.parameters, loopback.board
    for delay_s in (0.0, 0.5 * parameters.pulse_s):
        with (
            closing(commit_shot(loopback, "pulse")) as acquisition,
            closing(commit_coil(loopback.connection, parameters, loopback.position, board)) as coil,
        ):
            if delay_s:
                trigger = acquisition.task.triggers.start_trigger
                trigger.delay_units = DigitalWidthUnits.SECONDS
                trigger.delay = delay_s
            acquisition.start()
            coil.pulse()
            waveform = acquisition.read(READ_TIMEOUT_S)
        # The first sample comes some ticks after the edge, the last edge falls between two samples.
        left_s = parameters.pulse_s - delay_s
        assert high_s(waveform) == pytest.approx(left_s, abs=2.0 / LOOPBACK_RATE_HZ)


def test_a_holdoff_hides_the_pulse_from_the_trigger(loopback):
    """The line rises through the level with each pulse: held off, nothing triggers."""
    # At the loopback's rate the pre-trigger takes 10 ms of the fall; the rest is shared.
    held_off = replace(loopback.parameters, pretrigger_samples=2, holdoff_s=0.5 * loopback.parameters.fall_s)
    with pytest.raises(AcquisitionTimeoutError):
        one_shot(held_off, loopback.position)


@pytest.mark.usefixtures("may_strike")
def test_no_coil_takes_the_trigger_as_configured(parameters):
    """One strike each without a trigger: what the coil couples in has rung out when the trigger is armed."""
    for position in parameters.transducers:
        check, _ = strike_and_check_coil(parameters, position, READ_TIMEOUT_S)
        assert check.state == "ok", f"{position}: {check.found}; {check.remedy}"


@pytest.mark.usefixtures("may_strike")
def test_each_wave_comes_after_the_holdoff(parameters):
    """Held off for half the fall, every striker's wave is recorded all the same, and is no spike."""
    for position in parameters.transducers:
        waveform = one_shot(replace(parameters, holdoff_s=0.5 * parameters.fall_s, ringing_s=0.0), position)
        flags = extract_features(waveform).flags
        assert not {"missed", "false_trigger"} & set(flags), f"{position}: {flags}"


def test_no_other_coil_reaches_this_one(loopback, parameters):
    """Routes that a task gave up may stay connected: then two coils would pulse."""
    serial = loopback.board.serial
    others = [
        name
        for name, wiring in parameters.transducers.items()
        if name != loopback.position and normalize_serial(wiring.coil_serial) == serial
    ]
    if not others:
        pytest.skip("no other coil is driven by this board")
    one_shot(loopback.parameters, loopback.position)  # the route under suspicion was used, then given up
    for other in others:
        alone = replace(parameters, watchdog=None, watchdogs=None)
        with closing(commit_coil(loopback.connection, alone, other, loopback.board)) as coil:
            volts = noise_while(loopback, coil.pulse)
        assert np.abs(volts).max() < TTL_LOW_V, f"{loopback.position}'s line moved while {other} was struck"


def test_the_line_is_low_when_the_task_is_committed_and_when_it_is_gone(loopback):
    with closing(commit_coil(loopback.connection, loopback.parameters, loopback.position, loopback.board)):
        assert np.abs(noise_while(loopback)).max() < TTL_LOW_V, "committed"
    assert np.abs(noise_while(loopback)).max() < TTL_LOW_V, "cleared"


def test_the_watchdog_cuts_a_pulse_short(loopback):
    """The watchdog is not reset: half-way through the pulse the board itself pulls the line low."""
    from nidaqmx.constants import Level
    from nidaqmx.types import DOExpirationState

    parameters, board = loopback.parameters, loopback.board
    line = find_digital_line(parameters.transducers[loopback.position].output_terminal)
    if not line:
        pytest.skip(
            "this board's coils leave it at terminals without a digital line: it has no such watchdog"
        )
    timeout_s = parameters.initial_delay_s + 0.5 * parameters.pulse_s
    with closing(loopback.connection.create_watchdog(board.name, "watchdog", timeout_s)) as watchdog:
        watchdog.cfg_watchdog_do_expir_states(
            [DOExpirationState(physical_channel=f"{board.name}/{line}", expiration_state=Level.LOW)]
        )
        with (
            closing(commit_shot(loopback, "shot")) as acquisition,
            closing(commit_coil(loopback.connection, parameters, loopback.position, board)) as coil,
        ):
            acquisition.start()
            watchdog.start()
            coil.task.start()
            width_s = high_s(acquisition.read(READ_TIMEOUT_S))
            assert watchdog.expired
            watchdog.clear_expiration()
    # From the watchdog's start to the counter's is a call of the driver: milliseconds.
    assert width_s == pytest.approx(0.5 * parameters.pulse_s, abs=0.25 * parameters.pulse_s)
