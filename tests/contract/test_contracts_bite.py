"""Each contract fails an instrument that breaks it in one way."""

import math
import time
from dataclasses import replace

import pytest
from support.broken_instruments import (
    KEYS,
    UNKNOWN,
    ArmsAnything,
    ArmsOverAnArmedOne,
    CodesBeyondTheResolution,
    CountsInMillivolts,
    DisarmsOnce,
    EndsWhenSafe,
    GrowingRecords,
    InventsRecords,
    IsSafeOnce,
    LeavesTheCoilOn,
    MovesBeforeItRefuses,
    NoPretrigger,
    ReadsUnarmed,
    RemembersStrikes,
    SafeByAPulse,
    SettingsOfLists,
    SoundDigitizer,
    SoundStriker,
    StaysArmedAfterReading,
    StaysArmedAfterTimeout,
    StrikesAnotherCoil,
    StrikesTwice,
    TakesAnyTime,
    waveform,
)

from hardware_drivers.conformance.climate_probe_contract import ClimateProbeContract
from hardware_drivers.conformance.clock_contract import ClockContract
from hardware_drivers.conformance.digitizer_contract import DigitizerContract
from hardware_drivers.conformance.power_supply_contract import PowerSupplyContract
from hardware_drivers.conformance.pulse_echo_unit_contract import PulseEchoUnitContract
from hardware_drivers.conformance.striker_contract import StrikerContract
from hardware_drivers.errors import ConfigurationError, InstrumentError
from hardware_drivers.instruments import Acquired, Echo, require_timeout
from hardware_drivers.measurement import ClimateReading, ShotKey, Stamp, SupplyReading
from simulator.clock import SimulatedClock

EPOCH_NS = 10**18


GIVEN = {
    "timeout_s": 1.0,
    "longest_read_s": 20.0,
    "monotonic_s": time.monotonic,
    "caps": (12.0, 2.0),
    "order": (8.0, 1.5),
    "air": (22.0, 0.45),
}
"""Fixtures that the contracts have defaults of."""


def run(contract, test, **fixtures):
    """Call one test of a contract with only the fixtures that it requests."""
    function = getattr(contract, test)
    wanted = function.__code__.co_varnames[1 : function.__code__.co_argcount]
    function(contract(), **{name: {**GIVEN, **fixtures}[name] for name in wanted})


def each_test(contract):
    return [name for name in dir(contract) if name.startswith("test_")]


def digitizer_fixtures(digitizer):
    return {"digitizer": digitizer, "strike": digitizer.strike, "keys": KEYS, "unknown_key": UNKNOWN}


def test_a_digitizer_that_waits_too_long_fails():
    digitizer, now_s = SoundDigitizer(), iter((0.0, 600.0))
    fixtures = {**digitizer_fixtures(digitizer), "monotonic_s": lambda: next(now_s)}
    with pytest.raises(AssertionError, match=r"came back after 600\.0 s"):
        run(DigitizerContract, "test_waiting_is_bounded_by_its_timeout", **fixtures)


@pytest.mark.parametrize("test", each_test(DigitizerContract))
def test_a_sound_digitizer_passes(test):
    run(DigitizerContract, test, **digitizer_fixtures(SoundDigitizer()))


@pytest.mark.parametrize(
    ("broken", "test"),
    [
        (ArmsAnything, "test_an_unknown_position_is_refused_by_name"),
        (ArmsOverAnArmedOne, "test_arming_twice_is_refused"),
        (StaysArmedAfterReading, "test_reading_disarms"),
        (StaysArmedAfterTimeout, "test_no_strike_times_out_and_disarms"),
        (InventsRecords, "test_no_strike_times_out_and_disarms"),
        (ReadsUnarmed, "test_reading_unarmed_is_refused"),
        (RemembersStrikes, "test_a_strike_before_arming_is_lost"),
        (RemembersStrikes, "test_disarming_forgets_the_strike"),
        (GrowingRecords, "test_records_of_one_position_have_one_shape_and_calibration"),
        (NoPretrigger, "test_a_strike_on_an_armed_digitizer_is_recorded"),
        (CodesBeyondTheResolution, "test_counts_are_read_only_codes_of_their_calibration"),
        (CountsInMillivolts, "test_counts_are_read_only_codes_of_their_calibration"),
        (SettingsOfLists, "test_counts_are_read_only_codes_of_their_calibration"),
        (TakesAnyTime, "test_a_timeout_of_zero_is_refused"),
        (DisarmsOnce, "test_disarming_is_harmless_at_any_time"),
        (object, "test_is_a_digitizer"),
    ],
)
def test_a_broken_digitizer_fails(broken, test):
    digitizer = broken()
    fixtures = {"digitizer": digitizer} if broken is object else digitizer_fixtures(digitizer)
    with pytest.raises((AssertionError, InstrumentError, pytest.fail.Exception)):
        run(DigitizerContract, test, **fixtures)


STRIKER_KEYS = (KEYS[0], ShotKey(position="D", set_index=0, shot_index=0))


def striker_fixtures(striker):
    return {
        "striker": striker,
        "coil_levels": lambda: getattr(striker, "levels", ()),
        "keys": STRIKER_KEYS,
        "unknown_key": UNKNOWN,
    }


@pytest.mark.parametrize("test", each_test(StrikerContract))
def test_a_sound_striker_passes(test):
    run(StrikerContract, test, **striker_fixtures(SoundStriker()))


@pytest.mark.parametrize(
    ("broken", "test"),
    [
        (LeavesTheCoilOn, "test_a_strike_is_one_pulse_of_its_own_coil"),
        (StrikesTwice, "test_a_strike_is_one_pulse_of_its_own_coil"),
        (StrikesAnotherCoil, "test_a_strike_is_one_pulse_of_its_own_coil"),
        (StrikesAnotherCoil, "test_an_unknown_position_is_refused_by_name"),
        (MovesBeforeItRefuses, "test_a_refused_strike_moves_nothing"),
        (IsSafeOnce, "test_making_safe_twice_is_harmless"),
        (EndsWhenSafe, "test_making_safe_does_not_end_the_test"),
        (SafeByAPulse, "test_making_safe_is_never_a_pulse"),
        (object, "test_is_a_striker"),
    ],
)
def test_a_broken_striker_fails(broken, test):
    with pytest.raises((AssertionError, InstrumentError, pytest.fail.Exception)):
        run(StrikerContract, test, **striker_fixtures(broken()))


class SoundProbe:
    def __init__(self):
        self.shots = 0

    def acquire(self, key, timeout_s):
        require_timeout(timeout_s)
        if key == UNKNOWN:
            raise ConfigurationError(f"no probe at {key.position}")
        self.shots += 1
        return self.record()

    def record(self):
        return Echo(waveform=waveform(pretrigger=0))


class WanderingGain(SoundProbe):
    def record(self):
        return Echo(waveform=waveform(pretrigger=0), gain_db=float(self.shots))


class LateProbe(SoundProbe):
    def record(self):
        return Echo(waveform=waveform(pretrigger=5))


class BareRecord(SoundProbe):
    def record(self):
        return Acquired(waveform=waveform(pretrigger=0))


class ProbesAnything(SoundProbe):
    def acquire(self, key, timeout_s):
        return self.record()


@pytest.mark.parametrize("test", each_test(PulseEchoUnitContract))
def test_a_sound_probe_passes(test):
    run(PulseEchoUnitContract, test, pulse_echo=SoundProbe(), keys=KEYS, unknown_key=UNKNOWN)


@pytest.mark.parametrize(
    ("broken", "test"),
    [
        (WanderingGain, "test_records_of_one_position_have_one_shape"),
        (LateProbe, "test_a_record_starts_at_the_firing_pulse_and_names_its_receiver"),
        (BareRecord, "test_a_record_starts_at_the_firing_pulse_and_names_its_receiver"),
        (ProbesAnything, "test_an_unknown_position_is_refused_by_name"),
        (object, "test_is_a_pulse_echo_unit"),
    ],
)
def test_a_broken_probe_fails(broken, test):
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        run(PulseEchoUnitContract, test, pulse_echo=broken(), keys=KEYS, unknown_key=UNKNOWN)


class RunsBack(SimulatedClock):
    def mono_ns(self):
        self._utc_ns -= 1
        return self._utc_ns


class Seconds(SimulatedClock):
    def utc_ns(self):
        return super().utc_ns() / 1e9


class WakesEarly(SimulatedClock):
    def wait_until(self, utc_ns, idle):
        return super().wait_until(utc_ns - 1, idle)


class NeverLooks(SimulatedClock):
    def wait_until(self, utc_ns, idle):
        return super().wait_until(utc_ns, lambda: True)


class TurnsBack(SimulatedClock):
    def wait_until(self, utc_ns, idle):
        self._utc_ns = utc_ns
        return idle()


class Ahead(ClockContract):
    AHEAD_S = 3600.0


@pytest.mark.parametrize(
    ("broken", "test"),
    [
        (RunsBack, "test_times_are_whole_nanoseconds_that_never_run_back"),
        (Seconds, "test_times_are_whole_nanoseconds_that_never_run_back"),
        (WakesEarly, "test_waiting_reaches_the_time"),
        (NeverLooks, "test_a_wait_calls_idle"),
        (NeverLooks, "test_waiting_ends_as_soon_as_the_caller_wants"),
        (TurnsBack, "test_a_time_in_the_past_is_reached_at_once_and_changes_nothing"),
    ],
)
def test_a_broken_clock_fails(broken, test):
    with pytest.raises(AssertionError):
        run(Ahead, test, clock=broken(EPOCH_NS))


def test_an_arbitrary_object_is_not_accepted_as_a_clock():
    with pytest.raises(AssertionError):
        run(ClockContract, "test_is_a_clock", clock=object())


class SoundSupply:
    def __init__(self):
        self.on = True
        self.set_v = 5.0

    def energise(self, voltage_v, current_limit_a):
        self.require_within_caps(voltage_v, current_limit_a)
        self.on, self.set_v = True, voltage_v

    def require_within_caps(self, voltage_v, current_limit_a):
        if not (0.0 < voltage_v <= 12.0 and 0.0 < current_limit_a <= 2.0):
            raise ConfigurationError(f"{voltage_v:g} V or {current_limit_a:g} A is beyond the caps")

    def identity(self):
        return {"maker": "test", "model": "test"}

    def read(self, timeout_s):
        require_timeout(timeout_s)
        stamp = Stamp(utc_ns=1, mono_ns=1, boot_id="test")
        volts = self.set_v if self.on else 0.0
        return SupplyReading(stamp=stamp, voltage_v=volts, current_a=0.1 * volts, output_on=self.on)

    def make_safe(self):
        self.on = False


class StaysOn(SoundSupply):
    def make_safe(self):
        pass


class Toggles(SoundSupply):
    def make_safe(self):
        self.on = not self.on


class Recovers(SoundSupply):
    """Supply that switches itself on again after a while, as some do after a fault."""

    def read(self, timeout_s):
        reading = super().read(timeout_s)
        self.on = True
        return reading


class ReadsNothing(SoundSupply):
    def read(self, timeout_s):
        return replace(super().read(timeout_s), current_a=math.nan)


class KeepsTheFirstOrder(SoundSupply):
    def energise(self, voltage_v, current_limit_a):
        if self.set_v == 5.0:
            super().energise(voltage_v, current_limit_a)


class StaysOff(SoundSupply):
    def energise(self, voltage_v, current_limit_a):
        self.set_v = voltage_v


class ObeysAnything(SoundSupply):
    def require_within_caps(self, voltage_v, current_limit_a):
        pass


class CapsTheVoltageOnly(SoundSupply):
    def require_within_caps(self, voltage_v, current_limit_a):
        super().require_within_caps(voltage_v, 1.0)


class RefusesTooLate(SoundSupply):
    def energise(self, voltage_v, current_limit_a):
        self.on = True
        super().energise(voltage_v, current_limit_a)


class RefusesWithoutTheValue(SoundSupply):
    def require_within_caps(self, voltage_v, current_limit_a):
        try:
            super().require_within_caps(voltage_v, current_limit_a)
        except ConfigurationError:
            raise ConfigurationError("beyond the caps") from None


class IsAnybody(SoundSupply):
    def identity(self):
        return {"maker": "", "model": ""}


class ChangesItsName(SoundSupply):
    def identity(self):
        self.set_v += 1.0
        return {"maker": "test", "model": f"{self.set_v}"}


@pytest.mark.parametrize("test", each_test(PowerSupplyContract))
def test_a_sound_supply_passes(test):
    run(PowerSupplyContract, test, supply=SoundSupply())


@pytest.mark.parametrize(
    ("broken", "test"),
    [
        (StaysOn, "test_safe_means_off"),
        (Toggles, "test_making_safe_is_harmless_when_off"),
        (Recovers, "test_reading_never_switches_it_on_again"),
        (ReadsNothing, "test_a_reading_is_measured_and_dated"),
        (StaysOff, "test_energise_switches_on_at_the_requested_values"),
        (KeepsTheFirstOrder, "test_a_command_replaces_the_previous_one"),
        (ObeysAnything, "test_it_stays_off_above_the_caps"),
        (CapsTheVoltageOnly, "test_it_stays_off_above_the_caps"),
        (RefusesTooLate, "test_it_stays_off_above_the_caps"),
        (RefusesWithoutTheValue, "test_it_stays_off_above_the_caps"),
        (IsAnybody, "test_the_identity_is_reported"),
        (ChangesItsName, "test_the_identity_is_reported"),
        (object, "test_is_a_power_supply"),
    ],
)
def test_a_broken_supply_fails(broken, test):
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        run(PowerSupplyContract, test, supply=broken())


class SoundClimateProbe:
    def __init__(self):
        self.readings = 0

    def read(self, timeout_s):
        if not timeout_s > 0.0:
            raise ConfigurationError(f"timeout_s is {timeout_s}")
        self.readings += 1
        stamp = Stamp(utc_ns=10 + self.readings, mono_ns=self.readings, boot_id="test")
        return ClimateReading(stamp=stamp, temperature_c=22.3, relative_humidity=0.46)


class ReadsFahrenheit(SoundClimateProbe):
    def read(self, timeout_s):
        return replace(super().read(timeout_s), temperature_c=71.6)


class ReadsPercent(SoundClimateProbe):
    def read(self, timeout_s):
        return replace(super().read(timeout_s), relative_humidity=45.0)


class RunsBackwards(SoundClimateProbe):
    def read(self, timeout_s):
        self.readings -= 2
        return super().read(timeout_s)


class BootsEveryTime(SoundClimateProbe):
    def read(self, timeout_s):
        reading = super().read(timeout_s)
        return replace(reading, stamp=replace(reading.stamp, boot_id=str(self.readings)))


class NeverEnds(SoundClimateProbe):
    def read(self, timeout_s):
        return super().read(1.0)


@pytest.mark.parametrize("test", each_test(ClimateProbeContract))
def test_a_sound_climate_probe_passes(test):
    run(ClimateProbeContract, test, climate=SoundClimateProbe())


@pytest.mark.parametrize(
    ("broken", "test"),
    [
        (ReadsFahrenheit, "test_a_reading_is_in_degrees_celsius_and_a_fraction"),
        (ReadsPercent, "test_a_reading_is_in_degrees_celsius_and_a_fraction"),
        (RunsBackwards, "test_readings_are_dated_in_order"),
        (BootsEveryTime, "test_readings_are_dated_in_order"),
        (NeverEnds, "test_a_timeout_of_zero_is_refused"),
        (object, "test_is_a_climate_probe"),
    ],
)
def test_a_broken_climate_probe_fails(broken, test):
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        run(ClimateProbeContract, test, climate=broken())
