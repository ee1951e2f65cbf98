"""The corrosion supply control on a scripted supply and a manual clock."""

import pytest
from support.scripted_supply import ScriptedSupply, supply_parameters
from support.serial_rig import TestClock

from daq_service.alarms.states import build_alarm_texts
from daq_service.catalogue.rows import EnvironmentRow
from daq_service.corrosion_drive.charge import Command, DriveState
from daq_service.corrosion_drive.climate import ClimateLog
from daq_service.corrosion_drive.drive import SupplyLogger, build_absent_row, select_columns
from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError
from hardware_drivers.measurement import ClimateReading
from hardware_drivers.serial_port.parameters import ClimateParameters, SerialLineParameters

INTERVAL_S = 10.0
LINE = SerialLineParameters(port="COM4")
PARAMETERS = supply_parameters(
    voltage_v=10.0,
    current_limit_a=1.0,
    interlock_current_a=0.9,
    interlock_readings=3,
    interlock_lost_after_s=300.0,
)
CLIMATE = ClimateParameters(line=LINE, identity="ANY", log_interval_s=60.0)


class ScriptedProbe:
    def __init__(self, clock):
        self.clock = clock
        self.error = None
        self.calls = 0
        self.temperature_c = 21.5

    def read(self, timeout_s):
        self.calls += 1
        if self.error is not None:
            raise self.error
        return ClimateReading(
            stamp=self.clock.stamp(), temperature_c=self.temperature_c, relative_humidity=0.4
        )


LOST = ConnectionLostError("the supply at COM4 is gone")


class Bench:
    def __init__(self, state=None, kind=ScriptedSupply, **supply):
        self.clock = TestClock()
        self.supply = kind(self.clock)
        for name, value in supply.items():
            setattr(self.supply, name, value)
        self.probe = ScriptedProbe(self.clock)
        self.drive = SupplyLogger(
            self.supply, self.clock, PARAMETERS, DriveState() if state is None else state
        )
        self.climate = ClimateLog(self.probe, self.clock, CLIMATE)

    def run(self, seconds):
        """Tick every 0.5 s, as an idle recorder does."""
        for _ in range(round(seconds / 0.5)):
            self.drive.tick()
            self.climate.tick()
            self.clock.advance(0.5)

    def summarise_readings(self):
        return select_columns(self.climate.add_climate_to_row(self.drive.build_row(0, 0.0)))

    def active(self):
        return {condition.name for condition in self.drive.list_conditions() if condition.active}

    def message(self, name):
        found = next(condition for condition in self.drive.list_conditions() if condition.name == name)
        return build_alarm_texts(name, None, found.values, 1.0).message

    def trip_reason(self):
        """Return the reason in the values of the interlock's alarm."""
        conditions = {condition.name: condition for condition in self.drive.list_conditions()}
        return conditions["interlock_tripped"].values["trip_reason"]


@pytest.fixture
def energised():
    bench = Bench()
    bench.drive.energise("Ada")
    bench.run(60.0)
    return bench


# Reading -------------------------------------------------------------------------------------------


def test_one_call_queries_the_supply_at_most_once():
    bench = Bench()
    total = 0
    for _ in range(600):
        bench.drive.tick()
        calls = len(bench.supply.calls)
        assert calls - total <= 1
        bench.climate.tick()
        total = calls
        bench.clock.advance(0.5)
    assert bench.supply.calls == ["read"] * 30
    assert bench.probe.calls == 5


def test_a_busy_recorder_reads_once_afterwards(energised):
    energised.supply.calls.clear()
    energised.clock.advance(25.0)
    for _ in range(5):
        energised.drive.tick()
    assert energised.supply.calls == ["read"]
    energised.run(INTERVAL_S)
    assert energised.supply.calls == ["read"] * 2


def test_charge_is_the_integral_of_the_measured_current(energised):
    before = energised.summarise_readings()["charge_coulomb"]
    energised.supply.current_a = 0.4
    energised.run(120.0)
    # A reading every 10 s: 0.2 A until the one before the change, 0.4 A from the one after, 0.3 A between.
    flowed = energised.summarise_readings()["charge_coulomb"] - before
    assert flowed == pytest.approx(0.3 * 10.0 + 0.4 * 110.0, rel=1e-6)  # stamps differ by nanoseconds
    assert energised.summarise_readings()["unknown_s"] == 0.0


def test_the_summary_has_the_columns_of_the_catalogue(energised):
    columns = set(EnvironmentRow.__slots__) - {"id", "set_index", "due_h"}
    assert set(energised.summarise_readings()) == columns
    assert set(select_columns(build_absent_row(0, 0.0))) == columns


def test_a_window_holds_the_readings_of_its_set(energised):
    energised.drive.restart_means()
    for current_a in (0.2, 0.5, 0.3):
        energised.supply.current_a = current_a
        energised.run(INTERVAL_S)
    row = energised.summarise_readings()
    assert (row["current_min_a"], row["current_max_a"]) == (0.2, 0.5)
    assert row["current_a"] == pytest.approx(1.0 / 3.0, rel=1e-12)  # rounding of a mean
    assert (row["voltage_v"], row["voltage_min_v"], row["voltage_max_v"]) == (10.0, 10.0, 10.0)
    assert (row["temperature_c"], row["relative_humidity"], row["climate_quality"]) == (21.5, 0.4, "good")
    energised.drive.restart_means()
    row = energised.summarise_readings()
    assert row["current_a"] is None
    assert row["current_max_a"] is None
    assert row["charge_coulomb"] > 0.0, "totals go on"


def test_without_a_supply_the_state_is_absent():
    row = select_columns(build_absent_row(0, 0.0))
    assert (row["supply_state"], row["supply_quality"], row["climate_quality"]) == ("absent",) * 3
    assert row["charge_coulomb"] is None


def test_climate_and_supply_are_read_independently(energised):
    energised.supply.error = LOST
    energised.run(200.0)
    assert energised.summarise_readings()["climate_quality"] == "good"
    energised.supply.error, energised.probe.error = None, ConnectionLostError("probe gone")
    energised.run(200.0)
    row = energised.summarise_readings()
    assert (row["supply_quality"], row["climate_quality"]) == ("good", "no_communication")
    assert row["temperature_c"] == 21.5, "the last one, with its age"
    assert row["climate_age_s"] >= 180.0


# Lost links ----------------------------------------------------------------------------------------


def test_before_the_first_reading_the_state_is_unknown():
    bench = Bench()
    row = bench.summarise_readings()
    assert (row["supply_state"], row["supply_quality"], row["supply_age_s"]) == ("unknown", "stale", None)
    assert bench.active() == set()


@pytest.mark.parametrize("error", [LOST, BusyError("in use"), ConfigurationError("another instrument")])
def test_a_lost_supply_is_unknown_with_its_age_and_never_off(energised, error):
    energised.supply.error = error
    energised.run(INTERVAL_S)
    row = energised.summarise_readings()
    assert (row["supply_state"], row["supply_quality"]) == ("unknown", "stale"), "one answer missing"
    assert energised.active() == set(), "which is no alarm"
    energised.run(30.0)
    row = energised.summarise_readings()
    assert (row["supply_state"], row["supply_quality"]) == ("unknown", "no_communication")
    # The newest reading was the fixture's last, 10 s before it ended.
    assert row["supply_age_s"] == pytest.approx(50.0, abs=0.5)  # half a second between ticks
    assert row["unknown_s"] == row["supply_age_s"], "a silence that lasts is unknown time already"
    assert energised.active() == {"supply_not_responding"}
    assert str(error)[:20] in energised.message("supply_not_responding")


def test_time_without_readings_is_counted_once_and_not_integrated(energised):
    charge_c = energised.summarise_readings()["charge_coulomb"]
    energised.supply.error = LOST
    energised.run(100.0)
    energised.supply.error = None
    energised.run(INTERVAL_S)
    row = energised.summarise_readings()
    assert row["charge_coulomb"] == charge_c
    assert row["unknown_s"] == pytest.approx(110.0, abs=0.5)  # half a second between ticks
    assert row["supply_state"] == "on"
    energised.run(INTERVAL_S)
    assert energised.summarise_readings()["charge_coulomb"] > charge_c


# Interlock -----------------------------------------------------------------------------------------


def test_a_trip_switches_off_and_lasts_until_a_command(energised):
    assert energised.drive.trip("hole at B") is True
    assert not energised.supply.on
    energised.run(600.0)
    assert not any(call.startswith("energise") for call in energised.supply.calls[1:])
    assert energised.active() == {"interlock_tripped"}
    assert energised.trip_reason() == "hole at B"
    assert energised.summarise_readings()["supply_tripped"] == "hole at B"
    energised.drive.energise("Ada")
    energised.run(INTERVAL_S)
    assert energised.active() == set()
    assert energised.drive.tripped is None
    assert energised.drive.find_output_state() == "on"


def test_the_first_reason_of_a_trip_is_kept(energised):
    energised.drive.trip("hole at B")
    energised.drive.trip("hole at C")
    assert energised.drive.tripped == "hole at B"


@pytest.mark.parametrize("author", ["", "  "])
def test_an_empty_author_is_rejected(energised, author):
    energised.drive.trip("hole at B")
    energised.supply.calls.clear()
    with pytest.raises(ValueError, match="author"):
        energised.drive.energise(author)
    with pytest.raises(ValueError, match="author"):
        energised.drive.switch_off(author)
    assert energised.supply.calls == []
    assert energised.drive.tripped == "hole at B"


def test_a_failed_command_leaves_the_interlock_tripped(energised):
    energised.drive.trip("hole at B")
    energised.supply.error = ConfigurationError("its protection has tripped")
    with pytest.raises(ConfigurationError):
        energised.drive.energise("Ada")
    energised.supply.error = None
    energised.run(INTERVAL_S)
    assert energised.drive.tripped == "hole at B"
    assert not energised.supply.on


def test_overcurrent_trips_after_consecutive_readings(energised):
    energised.supply.current_a = 0.95
    energised.run(2 * INTERVAL_S)
    assert energised.active() == set()
    energised.supply.current_a = 0.2
    energised.run(INTERVAL_S)
    energised.supply.current_a = 0.95
    energised.run(2 * INTERVAL_S)
    assert energised.supply.on, "a reading below starts the count anew"
    energised.run(INTERVAL_S)
    assert not energised.supply.on
    assert "0.95 A in 3 consecutive readings" in energised.message("interlock_tripped")


def test_a_command_after_the_trip_cancels_the_pending_switch_off(energised):
    energised.supply.error = LOST
    energised.drive.trip("hole at B")
    energised.supply.error = None
    energised.drive.energise("Ada")
    energised.run(60.0)
    assert energised.supply.on
    assert energised.active() == set()


def test_a_silent_supply_trips_after_its_time_and_is_switched_off_later(energised):
    energised.supply.error = LOST
    energised.run(280.0)
    assert energised.drive.tripped is None
    energised.run(20.0)
    assert energised.drive.tripped.startswith("no answer from the supply for 30")
    assert energised.active() == {"supply_not_responding", "interlock_tripped", "supply_switch_off_pending"}
    energised.supply.error = None
    energised.run(INTERVAL_S)
    assert not energised.supply.on
    assert energised.active() == {"interlock_tripped"}


@pytest.mark.parametrize("off", ["command", "found"])
def test_silence_of_a_supply_that_is_off_trips_nothing(off):
    bench = Bench()
    if off == "command":
        bench.drive.energise("Ada")
        bench.run(60.0)
        bench.drive.switch_off("Ada")
    bench.run(60.0)
    assert (bench.active(), bench.drive.find_output_state()) == (set(), "off"), "which is no alarm"
    bench.supply.error = LOST
    bench.run(1000.0)
    assert bench.active() == {"supply_not_responding"}


# Conditions ----------------------------------------------------------------------------------------


def test_an_unreported_protection_is_named_as_a_possible_cause(energised):
    energised.supply.on = False
    energised.supply.protection_unknown = "dialect korad asks no protection"
    energised.run(60.0)
    assert "A protection may have tripped: dialect korad" in energised.message("supply_off_unexpectedly")


def test_the_current_limit_raises_its_alarm():
    bench = Bench()
    bench.drive.energise("Ada", voltage_v=8.0, current_limit_a=0.5)
    assert bench.supply.calls == ["energise 8 V 0.5 A"]
    bench.supply.current_a = 0.47
    bench.run(INTERVAL_S)
    assert bench.active() == set()
    bench.supply.current_a = 0.495
    bench.run(INTERVAL_S)
    assert bench.active() == {"supply_current_limit"}
    assert "V, 0.495 A, 8 V set" in bench.message("supply_current_limit")


# Restart -------------------------------------------------------------------------------------------


# Commands are latched ------------------------------------------------------------------------------


@pytest.mark.parametrize("off", ["command", "trip", "first start"])
def test_an_output_found_on_without_a_command_is_switched_off_and_an_alarm(off):
    bench = Bench()
    if off != "first start":
        bench.drive.energise("Ada")
        bench.run(INTERVAL_S)
    if off == "command":
        bench.drive.switch_off("Ada")
    elif off == "trip":
        bench.drive.trip("hole at B")
    bench.run(3600.0)
    assert "supply_on_unexpectedly" not in bench.active()
    bench.supply.on = True  # mains return, front panel, another program
    bench.run(INTERVAL_S)
    assert not bench.supply.on
    assert "supply_on_unexpectedly" in bench.active()
    assert "isolate the supply" in bench.message("supply_on_unexpectedly")
    bench.run(60.0)
    assert "supply_on_unexpectedly" in bench.active(), "it stays until the next command"
    bench.drive.switch_off("Ada")
    assert "supply_on_unexpectedly" not in bench.active()


def test_an_unexpected_off_ends_the_command(energised):
    energised.supply.on = False
    energised.supply.tripped_protections = ("VOLT:PROT:TRIP?",)
    energised.supply.calls.clear()
    energised.run(60.0)
    assert energised.active() == {"supply_off_unexpectedly"}
    assert "VOLT:PROT:TRIP?" in energised.message("supply_off_unexpectedly")
    assert energised.supply.calls == ["read"] * 6, "nothing is corrected"
    energised.supply.on = True  # it returns by itself
    energised.run(INTERVAL_S)
    assert not energised.supply.on
    assert energised.active() == {"supply_off_unexpectedly", "supply_on_unexpectedly"}
    energised.drive.energise("Ada")
    energised.run(INTERVAL_S)
    assert (energised.active(), energised.supply.on) == (set(), True)


def test_after_a_failed_command_on_it_switches_off_until_the_output_reads_off():
    bench = Bench()
    bench.run(INTERVAL_S)
    energise = bench.supply.energise

    def reaches_it_then_the_link_dies(voltage_v, current_limit_a):
        energise(voltage_v, current_limit_a)
        bench.supply.error = LOST
        raise LOST

    bench.supply.energise = reaches_it_then_the_link_dies
    with pytest.raises(ConnectionLostError, match="switch-off pending, the output may be ON"):
        bench.drive.energise("Ada")
    bench.run(15.0)
    assert bench.supply.on, "it cannot be reached"
    assert "supply_switch_off_pending" in bench.active()
    assert "by hand immediately" in bench.message("supply_switch_off_pending")
    bench.supply.error = None
    bench.run(INTERVAL_S)
    assert not bench.supply.on
    assert bench.active() == set()


def test_a_pending_switch_off_is_tried_more_often_than_readings(energised):
    energised.supply.error = LOST
    energised.drive.trip("hole at B")
    energised.supply.calls.clear()
    energised.run(60.0)
    assert energised.supply.calls == ["make_safe"] * 12


@pytest.mark.parametrize(("voltage_v", "limit_a"), [(12.1, 1.0), (10.0, 2.1), (0.0, 1.0)])
def test_a_command_above_a_cap_is_rejected_and_changes_nothing(energised, voltage_v, limit_a):
    energised.supply.calls.clear()
    with pytest.raises(ConfigurationError, match="nothing was sent"):
        energised.drive.energise("Ada", voltage_v=voltage_v, current_limit_a=limit_a)
    energised.run(60.0)
    assert energised.supply.calls == ["read"] * 6
    assert energised.supply.on
    assert energised.active() == set()


def test_a_restart_restores_the_command_and_its_limit():
    bench = Bench(DriveState(command=Command(voltage_v=10.0, current_limit_a=0.2)), on=True)
    bench.run(INTERVAL_S)
    assert bench.active() == {"supply_current_limit"}
    bench = Bench(DriveState(command=Command()))
    bench.run(60.0)
    assert bench.active() == {"supply_off_unexpectedly"}
    assert set(bench.supply.calls) == {"read"}


def test_silence_from_the_start_trips_what_was_commanded_on():
    bench = Bench(DriveState(command=Command()), error=LOST)
    bench.run(350.0)
    assert bench.active() == {"supply_not_responding", "interlock_tripped", "supply_switch_off_pending"}


# Deviations ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("voltage_v", "current_a", "active"),
    [
        (10.0, 0.0, {"supply_deviation"}),  # a lead is off, the bath is dry
        (3.0, 0.2, {"supply_deviation"}),
        (10.2, 0.2, {"supply_deviation"}),
        (3.0, 0.5, {"supply_current_limit"}),
        (10.0, 0.2, set()),
        (9.96, 0.003, set()),
    ],
)
def test_voltage_or_current_away_from_the_command_for_minutes(voltage_v, current_a, active):
    bench = Bench()
    bench.drive.energise("Ada", current_limit_a=0.5)
    bench.supply.voltage_v, bench.supply.current_a = voltage_v, current_a
    bench.run(PARAMETERS.deviation_after_s - INTERVAL_S)
    assert bench.active() <= {"supply_current_limit"}
    bench.run(3 * INTERVAL_S)
    assert bench.active() == active
    assert bench.supply.on, "nothing is switched"
    bench.supply.voltage_v, bench.supply.current_a = 10.0, 0.2
    bench.run(INTERVAL_S)
    assert bench.active() == set()


@pytest.mark.parametrize(
    ("voltage_v", "current_a", "reason"),
    [(25.0, 0.2, "25 V is above the cap of 12 V"), (10.0, 2.5, "2.5 A is above the cap of 2 A")],
)
def test_above_the_cap_the_output_is_off_at_once(energised, voltage_v, current_a, reason):
    energised.supply.voltage_v, energised.supply.current_a = voltage_v, current_a
    energised.run(INTERVAL_S)
    assert not energised.supply.on
    assert energised.active() == {"supply_above_cap", "interlock_tripped"}
    assert energised.trip_reason() == reason


# Climate -------------------------------------------------------------------------------------------


def test_a_probe_that_dies_is_not_responding_and_one_that_repeats_itself_is_suspect():
    bench = Bench()
    bench.run(CLIMATE.suspect_after_s - 60.0)
    assert (bench.climate.quality(), bench.climate.build_condition().active) == ("good", False)
    bench.run(120.0)
    assert bench.summarise_readings()["climate_quality"] == "suspect"
    bench.probe.temperature_c = 21.6
    bench.run(60.0)
    assert bench.climate.quality() == "good"
    bench.probe.error = ConnectionLostError("probe gone")
    bench.run(300.0)
    silent = bench.climate.build_condition()
    assert silent.active
    message = build_alarm_texts(silent.name, None, silent.values, 1.0).message
    assert message.startswith("Climate probe not responding. No reading for ")
    assert "s: probe gone (hour 1.0). Check its cable and port." in message
