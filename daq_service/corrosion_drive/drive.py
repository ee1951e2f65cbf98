"""Corrosion supply while a test runs: readings, charge, and the interlock.

Its owner calls `tick` continuously: the supply process (`own_process`), or a recorder in a test. One call
queries the supply once, so it lasts no longer than its timeout; nothing here waits or runs by itself.

Only a person's command switches the output on. A command `off` and a trip of the interlock are latched until
the next command `on`, also over a restart: an output that is found on without a command is switched off.
While the connection is lost a switch-off is pending; it follows as soon as the supply responds.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

from daq_service.catalogue.rows import EnvironmentRow, Priority, SupplyState, as_dict
from daq_service.corrosion_drive.charge import Command, DriveState, compute_elapsed_s, integrate_charge
from daq_service.corrosion_drive.reading_log import LONGEST_GAP_INTERVALS, ReadingLog
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Clock, PowerSupply
from hardware_drivers.measurement import SupplyReading
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

SWITCH_OFF_EVERY_S = 5.0
"""Longest interval between attempts of a pending switch-off, independent of the reading interval."""
CONDITIONS: Mapping[str, Priority] = {
    "supply_not_responding": "high",
    "supply_off_unexpectedly": "medium",
    "supply_on_unexpectedly": "high",
    "supply_switch_off_pending": "critical",
    "supply_current_limit": "medium",
    "supply_deviation": "medium",
    "supply_above_cap": "high",
    "interlock_tripped": "critical",
    "supply_watchdog_trip": "high",
    "climate_not_responding": "low",
}
"""Priority of each possible alarm of supply and climate probe, in their order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveCondition:
    """Condition of one possible alarm, with the values for its texts while it is active."""

    name: str
    active: bool
    values: Mapping[str, object] = field(default_factory=dict)


@dataclass(slots=True)
class Reply:
    """Reply to a command, filled in as soon as it is there."""

    done: bool = False
    error: str = ""


@runtime_checkable
class ReportsProtections(Protocol):
    """Supply that reports why its output went off."""

    @property
    def tripped_protections(self) -> tuple[str, ...]:
        """Return the protections found tripped when the output was last found off; empty without a trip."""
        ...

    @property
    def protection_unknown(self) -> str:
        """Return the reason why a protection can trip without a report; empty if the supply reports it."""
        ...


class SupplyLogger:
    """Logs the supply, integrates the charge, and runs the interlock.

    Parameters
    ----------
    clock
        Its monotonic time schedules the readings.
    state
        State at the end of the last run; see `charge.restore_drive_state`.

    Attributes
    ----------
    tripped
        Reason why the interlock has tripped; None if it has not.
    must_switch_off
        The output must be off and has not been read as off; each tick tries again.
    """

    def __init__(
        self, supply: PowerSupply, clock: Clock, parameters: DriveParameters, state: DriveState
    ) -> None:
        """Continue from ``state`` and schedule the first reading for now; nothing is sent here."""
        self._supply, self._parameters = supply, parameters
        self._clock = clock
        now_ns = clock.mono_ns()
        self._supply_log = ReadingLog(parameters.log_interval_s, now_ns)
        self._charge = state.charge
        self.tripped, self._latched = state.tripped, state.latched
        self._command, self.must_switch_off = state.command, state.must_switch_off
        self._commanded_ns = now_ns
        self._booked_utc_ns = state.booked_utc_ns
        self._newest: SupplyReading | None = None
        self._window: list[SupplyReading] = []
        self._high_readings = 0
        self._deviates_since_ns: int | None = None

    @property
    def state(self) -> DriveState:
        """Return the state (charge, command, trip, pending switch-off) from which a restart continues."""
        return DriveState(
            charge=self._charge,
            command=self._command,
            must_switch_off=self.must_switch_off,
            tripped=self.tripped,
            latched=self._latched,
            booked_utc_ns=self._booked_utc_ns,
        )

    @property
    def window_length(self) -> int:
        """Return the number of readings since `restart_means`, from which `build_row` takes its means."""
        return len(self._window)

    # Called by its owner continuously ------------------------------------------------------------

    def tick(self) -> None:
        """Read the supply, or repeat a pending switch-off, if due; else do nothing.

        Blocks for one call of the supply. An instrument error is logged, not raised; with a command in force,
        a long silence trips the interlock.
        """
        now_ns = self._clock.mono_ns()
        if self._supply_log.is_due(now_ns):
            self._supply_log.record_attempt(now_ns)
            try:
                self._switch_off_or_read(self._supply, now_ns)
            except InstrumentError as error:
                self._handle_failure(error, now_ns)
            if self.must_switch_off:
                self._supply_log.schedule_within(now_ns, SWITCH_OFF_EVERY_S)

    def _switch_off_or_read(self, supply: PowerSupply, now_ns: int) -> None:
        """Switch the supply off if that is pending; otherwise read it and process the reading.

        InstrumentError of the supply passes through; a switch-off then stays pending.
        """
        if self.must_switch_off:
            supply.make_safe()
            self.must_switch_off = False
            self._supply_log.schedule_now(now_ns)
        else:
            reading = supply.read(self._parameters.read_timeout_s)
            self._supply_log.record_success(self._clock.mono_ns())
            self._process_reading(reading)

    def _process_reading(self, reading: SupplyReading) -> None:
        """Store a reading, add its charge, and switch the output off where that is required.

        An output on without a command, a value above its cap, and consecutive high currents switch off; the
        latter two trip the interlock. An output found off ends the command.
        """
        self._book_charge(reading)
        self._window.append(reading)
        self._newest = reading
        parameters = self._parameters
        if reading.output_on and self._command is None:
            log.error("the output is on without a command: %g V, %g A", reading.voltage_v, reading.current_a)
            self._latched |= {"supply_on_unexpectedly"}
            self._switch_off_now()
            return
        if self._command is not None and not reading.output_on and self._is_after_command(reading):
            # If the output comes on again by itself later, that is not the command.
            self._command = None
            self._latched |= {"supply_off_unexpectedly"}
        for measured, cap, tolerance, unit in (
            (reading.voltage_v, parameters.voltage_cap_v, parameters.readback_tolerance_v, "V"),
            (reading.current_a, parameters.current_cap_a, parameters.readback_tolerance_a, "A"),
        ):
            if reading.output_on and measured > cap + tolerance:
                reason = f"{measured:.3g} {unit} is above the cap of {cap:g} {unit}"
                self.trip(reason, kind="supply_above_cap")
                return
        high = reading.output_on and reading.current_a >= parameters.interlock_current_a
        self._high_readings = self._high_readings + 1 if high else 0
        if self._high_readings >= parameters.interlock_readings:
            self.trip(
                f"{reading.current_a:.3g} A in {self._high_readings} consecutive readings, at or above "
                f"interlock_current_a = {parameters.interlock_current_a:g} A"
            )
            return
        deviates = self._is_after_command(reading) and self._is_deviating(reading)
        self._deviates_since_ns = (self._deviates_since_ns or reading.stamp.mono_ns) if deviates else None

    def _is_after_command(self, reading: SupplyReading) -> bool:
        """Return whether a reading was taken at or after the last command `on`.

        An older reading does not show the result of that command.
        """
        return reading.stamp.mono_ns >= self._commanded_ns

    def _find_setpoints(self) -> tuple[float, float]:
        """Return voltage in V and current limit in A of the command in force, else the configured values."""
        command, parameters = self._command or Command(), self._parameters
        return (
            parameters.voltage_v if command.voltage_v is None else command.voltage_v,
            parameters.current_limit_a if command.current_limit_a is None else command.current_limit_a,
        )

    def _is_in_cc_mode(self, reading: SupplyReading) -> bool:
        """Return whether the output is on and its current reaches the commanded limit less the tolerance."""
        limit_a = self._find_setpoints()[1]
        return reading.output_on and reading.current_a >= limit_a - self._parameters.readback_tolerance_a

    def _is_deviating(self, reading: SupplyReading) -> bool:
        """Return whether voltage or current of an output that is on by command is beyond its tolerance.

        In current limit a low voltage is normal. A current below ``minimum_current_a`` deviates. False
        without a command, or while the output is off.
        """
        voltage_v, limit_a = self._find_setpoints()
        parameters = self._parameters
        above_v = reading.voltage_v - voltage_v
        return (
            reading.output_on
            and self._command is not None
            and (
                above_v > parameters.readback_tolerance_v
                or (above_v < -parameters.readback_tolerance_v and not self._is_in_cc_mode(reading))
                or not parameters.minimum_current_a
                <= reading.current_a
                <= limit_a + parameters.readback_tolerance_a
            )
        )

    def _book_charge(self, reading: SupplyReading) -> None:
        """Add the charge since the last reading; a gap that is too long adds to the unknown time instead.

        At the first reading, the time since the end of the last run's charge is unknown.
        """
        if self._newest is not None:
            self._charge = integrate_charge(
                self._charge,
                elapsed_s=compute_elapsed_s(self._newest.stamp, reading.stamp),
                first_a=self._newest.current_a,
                last_a=reading.current_a,
                longest_s=LONGEST_GAP_INTERVALS * self._parameters.log_interval_s,
            )
        elif self._booked_utc_ns is not None:
            # Nothing was measured while no recorder ran.
            gap_s = max(0.0, (reading.stamp.utc_ns - self._booked_utc_ns) / NS_PER_S)
            self._charge = replace(self._charge, unknown_s=self._charge.unknown_s + gap_s)
        self._booked_utc_ns = reading.stamp.utc_ns

    def _handle_failure(self, error: InstrumentError, now_ns: int) -> None:
        """Log the first of consecutive instrument errors, and trip the interlock after a long silence.

        It trips only with a command in force; nothing is sent here, the switch-off is then pending.
        """
        if not self._supply_log.error:
            log.warning("supply: %s", error)
        self._supply_log.error = str(error)
        silent_s = self._supply_log.silent_s(now_ns)
        if self._command is not None and silent_s >= self._parameters.interlock_lost_after_s:
            # Not reachable now: it is switched off as soon as it responds.
            self._latch_interlock(f"no answer from the supply for {silent_s:.0f} s: {error}")

    # Commands ------------------------------------------------------------------------------------

    def energise(
        self, author: str, *, voltage_v: float | None = None, current_limit_a: float | None = None
    ) -> Reply:
        """Switch the output on at a person's command, and reset the interlock; blocks for the supply.

        Parameters
        ----------
        author
            Author of the command.
        voltage_v, current_limit_a
            Voltage in V and current limit in A; None: as configured.

        Raises
        ------
        ValueError
            No author: only a person may switch it on.
        InstrumentError
            The supply did not execute it. Above a cap nothing has changed; otherwise the output is off, or
            its switch-off is pending.
        """
        if not author.strip():
            raise ValueError("a command to switch on needs its author")
        parameters = self._parameters
        voltage_v = parameters.voltage_v if voltage_v is None else voltage_v
        limit_a = parameters.current_limit_a if current_limit_a is None else current_limit_a
        parameters.require_within_caps(voltage_v, limit_a)
        now_ns = self._clock.mono_ns()
        self._supply_log.schedule_now(now_ns)
        try:
            self._supply.energise(voltage_v, limit_a)
        except InstrumentError as error:
            self.end_command()
            if not self._switch_off_now():
                raise type(error)(f"{error}; switch-off pending, the output may be ON") from error
            raise
        log.warning("output switched on by %s: %g V, at most %g A", author, voltage_v, limit_a)
        self.tripped, self._latched, self.must_switch_off = None, frozenset(), False
        self._command, self._high_readings = Command(voltage_v=voltage_v, current_limit_a=limit_a), 0
        self._commanded_ns, self._deviates_since_ns = self._clock.mono_ns(), None
        return Reply(done=True)

    def switch_off(self, author: str) -> Reply:
        """Switch the output off at a person's command; an interlock that has tripped stays so.

        The command `on` ends, and alarms of an unexpected output state are reset. Blocks for the supply.

        Raises
        ------
        ValueError
            No author.
        InstrumentError
            The state of the output is unknown; its switch-off is pending.
        """
        if not author.strip():
            raise ValueError("a command to switch off needs its author")
        self._supply_log.schedule_now(self._clock.mono_ns())
        self.end_command()
        self._latched -= {"supply_on_unexpectedly", "supply_off_unexpectedly"}
        self.must_switch_off = True
        self._supply.make_safe()
        self.must_switch_off = False
        log.warning("output switched off by %s", author)
        return Reply(done=True)

    def switch_off_at_end(self) -> None:
        """Switch the output off at the end of a test, as `switch_off` does.

        InstrumentError if that fails: the switch-off is pending.
        """
        self.switch_off("the end of the test")

    def end_command(self) -> None:
        """End the command `on` and schedule a reading now; an output found on later is switched off.

        Nothing is sent here.
        """
        if self._command is not None:
            self._supply_log.schedule_now(self._clock.mono_ns())
        self._command, self._high_readings = None, 0

    def trip(self, reason: str, *, kind: str | None = None) -> bool:
        """Trip the interlock: switch the output off at once or when the supply responds, and keep it off.

        An instrument error is logged, not raised.

        Parameters
        ----------
        kind
            A further alarm that lasts until the next command `on`.

        Returns
        -------
        bool
            True if the output was read back as off; False if that is pending.
        """
        self._latched |= {kind} if kind is not None else set()
        self._latch_interlock(reason)
        return self._switch_off_now()

    def _latch_interlock(self, reason: str) -> None:
        """Store the reason of the first trip and log it, end the command, and make a switch-off pending.

        Nothing is sent here.
        """
        if self.tripped is None:
            self.tripped = reason
            log.error("interlock tripped: %s", reason)
        self.end_command()
        self.must_switch_off = True

    def _switch_off_now(self) -> bool:
        """Switch the output off; return True if it was read back as off.

        Return False after an instrument error, which is logged: the switch-off stays pending.
        """
        now_ns = self._clock.mono_ns()
        self.must_switch_off = True
        try:
            self._supply.make_safe()
        except InstrumentError as error:
            self._handle_failure(error, now_ns)
            return False
        self.must_switch_off = False
        self._supply_log.schedule_now(now_ns)
        return True

    # Readings and conditions ----------------------------------------------------------------------

    def find_output_state(self) -> SupplyState:
        """Return ``on`` or ``off`` as last read; ``unknown`` unless the newest reading is of good quality."""
        if self._newest is None or self._supply_log.quality(self._clock.mono_ns()) != "good":
            return "unknown"
        return "on" if self._newest.output_on else "off"

    def list_conditions(self) -> tuple[DriveCondition, ...]:
        """Return the condition of each possible alarm of supply and interlock, active or not.

        They are in the order of `CONDITIONS`; active ones hold the present values.
        """
        now_ns, reading, command = self._clock.mono_ns(), self._newest, self._command
        voltage_v, limit_a = self._find_setpoints()
        measured = "" if reading is None else f"{reading.voltage_v:.3g} V, {reading.current_a:.3g} A"
        tripped_by = None
        if isinstance(self._supply, ReportsProtections):
            if tripped := self._supply.tripped_protections:
                tripped_by = f"protection tripped: {', '.join(tripped)}"
            elif unknown := self._supply.protection_unknown:
                tripped_by = f"a protection may have tripped: {unknown}"
        deviates_s = 0.0
        if command is not None and reading is not None and self._deviates_since_ns is not None:
            deviates_s = (reading.stamp.mono_ns - self._deviates_since_ns) / NS_PER_S
        values = {
            "silent_s": self._supply_log.silent_s(now_ns),
            "read_error": self._supply_log.error or None,
            "tripped_by": tripped_by,
            "measured": measured,
            "setpoint": f"{voltage_v:g} V",
            "least_a": self._parameters.minimum_current_a,
            "limit_a": limit_a,
            "trip_reason": self.tripped,
            "unverified": self.must_switch_off or None,
        }
        active = dict.fromkeys(self._latched, True) | {
            "supply_not_responding": self._supply_log.quality(now_ns) == "no_communication",
            "supply_switch_off_pending": self.must_switch_off,
            "supply_current_limit": reading is not None and self._is_in_cc_mode(reading),
            "supply_deviation": deviates_s >= self._parameters.deviation_after_s,
            "interlock_tripped": self.tripped is not None,
        }
        return tuple(
            DriveCondition(name=name, active=True, values=values)
            if active.get(name)
            else DriveCondition(name=name, active=False)
            for name in CONDITIONS
            if name.startswith(("supply", "interlock"))
        )

    def restart_means(self, n_stored: int | None = None) -> None:
        """Delete the first ``n_stored`` readings from the means of the next row; None: all of them.

        Called after a row is stored; readings after those stay for the next row.
        """
        del self._window[:n_stored]

    def build_row(self, set_index: int, due_h: float) -> EnvironmentRow:
        """Build the environment row of a set: means since `restart_means`, totals since hour 0.

        ``due_h`` is the set's test hour. Voltages (V) and currents (A) are None without a reading since then;
        the climate is marked as absent.
        """
        now_ns, reading_log = self._clock.mono_ns(), self._supply_log
        voltages_v = [reading.voltage_v for reading in self._window]
        currents_a = [reading.current_a for reading in self._window]
        # A gap that is too long counts as unknown time already before a reading ends it.
        open_s = (
            reading_log.silent_s(now_ns)
            if self._newest is not None and reading_log.is_too_old(now_ns)
            else 0.0
        )
        return EnvironmentRow(
            set_index=set_index,
            due_h=due_h,
            supply_state=self.find_output_state(),
            supply_quality=reading_log.quality(now_ns),
            supply_age_s=reading_log.age_s(now_ns),
            supply_tripped=self.tripped,
            voltage_v=_mean_or_none(voltages_v),
            voltage_min_v=min(voltages_v, default=None),
            voltage_max_v=max(voltages_v, default=None),
            current_a=_mean_or_none(currents_a),
            current_min_a=min(currents_a, default=None),
            current_max_a=max(currents_a, default=None),
            charge_coulomb=self._charge.coulomb,
            unknown_s=self._charge.unknown_s + open_s,
            climate_quality="absent",
        )


def build_absent_row(set_index: int, due_h: float) -> EnvironmentRow:
    """Build the environment row of a set, due at test hour ``due_h``, without supply and climate probe.

    Both are marked as ``absent``; measured columns are None.
    """
    return EnvironmentRow(
        set_index=set_index,
        due_h=due_h,
        supply_state="absent",
        supply_quality="absent",
        climate_quality="absent",
    )


def select_columns(row: EnvironmentRow) -> dict[str, float | str | None]:
    """Return an ``environment`` row as a dictionary without ``id``, ``set_index`` and ``due_h``."""
    return {name: value for name, value in as_dict(row).items() if name not in ("id", "set_index", "due_h")}


def _mean_or_none(numbers: Sequence[float]) -> float | None:
    """Compute the mean of numbers; None if there are none."""
    return sum(numbers) / len(numbers) if numbers else None
