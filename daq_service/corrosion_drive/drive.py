"""The corrosion drive while a test runs: what was measured, what charge has flowed, and the interlock.

Its owner calls `tick` all the time: the process of the drive (`own_process`), or a recorder in a test. One
call asks the supply once, so it lasts no longer than its timeout; nothing here waits or runs by itself.

Only a person's order switches the output on. The interlock switches it off and stays tripped until the
next such order, also over a restart. It needs the line: while that is lost it can only say so, and it
switches off as soon as the supply answers again.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, runtime_checkable

from daq_service.catalogue.rows import EnvironmentRow, SupplyState, values
from daq_service.corrosion_drive.charge import DriveState, add_interval, elapsed_s
from daq_service.corrosion_drive.reading_log import LONGEST_GAP_INTERVALS, ReadingLog
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Clock, PowerSupply
from hardware_drivers.measurement import SupplyReading
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveCondition:
    """What the drive says of one possible alarm."""

    name: Literal[
        "supply_lost",
        "supply_off_unexpectedly",
        "supply_limit",
        "interlock_tripped",
        "supply_unwatched",
    ]
    active: bool
    message: str


@runtime_checkable
class ReadsBack(Protocol):
    """A supply that tells what is set on it."""

    def read_back(self, timeout_s: float) -> Mapping[str, float | str]:
        """Set voltage, current limit, output and tripped protections."""
        ...


@runtime_checkable
class TellsProtections(Protocol):
    """A supply that tells why its output went off."""

    @property
    def tripped_protections(self) -> tuple[str, ...]:
        """Protections found tripped when the output was last found off."""
        ...

    @property
    def protection_unknown(self) -> str:
        """Why a protection could trip without being told; empty where the supply tells."""
        ...


class SupplyDrive(Protocol):
    """The drive as a recorder sees it: here, or in a process of its own (`remote`)."""

    def tick(self) -> None:
        """Do what is due; an instrument's error is noted and never raised."""
        ...

    def conditions(self) -> tuple[DriveCondition, ...]:
        """Possible alarms, each with whether it stands."""
        ...

    def row(self, set_index: int, due_h: float) -> EnvironmentRow:
        """Row of a set: means since `begin_window`, totals since hour 0; without climate."""
        ...

    def begin_window(self) -> None:
        """Start the means anew, once the last row is stored."""
        ...

    def energise(
        self, author: str, *, voltage_v: float | None = None, current_limit_a: float | None = None
    ) -> None:
        """Switch the output on at a person's order, and close the interlock."""
        ...

    def switch_off(self, author: str) -> None:
        """Switch the output off at a person's order; the interlock stays as it is."""
        ...

    def trip(self, reason: str) -> bool:
        """Open the interlock; True if the output was read back as off."""
        ...


class ElectrochemicalDrive:
    """Logs the supply, integrates the charge, and keeps the interlock.

    Parameters
    ----------
    clock
        Its monotonic time says when a reading is due.
    state
        What the last run left; see `charge.restored_state`.
    """

    def __init__(
        self, supply: PowerSupply, clock: Clock, parameters: DriveParameters, state: DriveState
    ) -> None:
        self._supply, self._parameters = supply, parameters
        self._clock = clock
        now_ns = clock.mono_ns()
        self._supply_log = ReadingLog(parameters.log_interval_s, now_ns)
        self._charge = state.charge
        self._tripped, self._unwatched = state.tripped, state.unwatched
        self._intended_on = state.output_on
        self._ordered_ns = now_ns
        self._booked_utc_ns = state.booked_utc_ns
        self._newest: SupplyReading | None = None
        self._window: list[SupplyReading] = []
        self._limit_a = parameters.current_limit_a
        self._high_readings = 0
        self._must_switch_off = False
        self._must_read_back, self._read_back_next = True, False
        self._found: Mapping[str, float | str] = {}

    @property
    def tripped(self) -> str | None:
        """Why the interlock is open; None: it is closed."""
        return self._tripped

    @property
    def owes_switching_off(self) -> bool:
        """The output could not be switched off yet; each further reading tries again."""
        return self._must_switch_off

    @property
    def state(self) -> DriveState:
        """What whoever comes after this process must know."""
        return DriveState(
            charge=self._charge,
            tripped=self._tripped,
            unwatched=self._unwatched,
            output_on=self._intended_on,
            booked_utc_ns=self._booked_utc_ns,
        )

    @property
    def window_length(self) -> int:
        """Number of readings in the means."""
        return len(self._window)

    @property
    def found(self) -> Mapping[str, float | str]:
        """What was set on the supply at the start, or after it was lost: reported, never changed."""
        return self._found

    # Called by its owner all the time ------------------------------------------------------------

    def tick(self) -> None:
        """Do what is due; an instrument's error is noted and never raised."""
        now_ns = self._clock.mono_ns()
        if self._supply_log.due(now_ns):
            self._supply_log.attempted(now_ns)
            try:
                self._attend(self._supply, now_ns)
            except InstrumentError as error:
                self._note_failure(error, now_ns)

    def _attend(self, supply: PowerSupply, now_ns: int) -> None:
        """Switch off if that is still owed; else read back once after every loss; else read."""
        if self._must_switch_off:
            supply.make_safe()
            self._must_switch_off = False
            self._supply_log.look_again_at_once(now_ns)
        elif self._read_back_next and isinstance(supply, ReadsBack):
            self._read_back_next = False  # whatever comes of it, the next call measures
            self._found = supply.read_back(self._parameters.read_timeout_s)
            self._must_read_back = False
            self._limit_a = float(self._found.get("set_current_limit_a", self._limit_a))
            log.info("the supply was found like this: %s", dict(self._found))
        else:
            reading = supply.read(self._parameters.read_timeout_s)
            self._supply_log.succeeded(self._clock.mono_ns())
            self._take(reading)
            if self._must_read_back and isinstance(supply, ReadsBack):
                self._read_back_next = True
                self._supply_log.look_again_at_once(now_ns)

    def _take(self, reading: SupplyReading) -> None:
        self._book(reading)
        self._window.append(reading)
        self._newest = reading
        if self._tripped is not None and reading.output_on:
            log.warning("the output is on although the interlock tripped: %s", self._tripped)
            self._switch_off_now()
            return
        if self._intended_on is None or (reading.output_on and not self._intended_on):
            # Found like this at the start, or switched on at the front panel: a person wants it.
            self._intended_on = reading.output_on
        high = reading.current_a >= self._parameters.interlock_current_a
        self._high_readings = self._high_readings + 1 if high else 0
        if self._high_readings >= self._parameters.interlock_readings:
            self.trip(
                f"{reading.current_a:.3g} A in {self._high_readings} readings in a row, at or above "
                f"interlock_current_a = {self._parameters.interlock_current_a:g} A"
            )

    def _book(self, reading: SupplyReading) -> None:
        if self._newest is not None:
            self._charge = add_interval(
                self._charge,
                elapsed_s=elapsed_s(self._newest.stamp, reading.stamp),
                first_a=self._newest.current_a,
                last_a=reading.current_a,
                longest_s=LONGEST_GAP_INTERVALS * self._parameters.log_interval_s,
            )
        elif self._booked_utc_ns is not None:
            # Nobody measured while no recorder ran.
            gap_s = max(0.0, (reading.stamp.utc_ns - self._booked_utc_ns) / NS_PER_S)
            self._charge = replace(self._charge, unknown_s=self._charge.unknown_s + gap_s)
        self._booked_utc_ns = reading.stamp.utc_ns

    def _note_failure(self, error: InstrumentError, now_ns: int) -> None:
        if not self._supply_log.trouble:
            log.warning("supply: %s", error)
        self._supply_log.trouble = str(error)
        self._must_read_back = True
        silent_s = self._supply_log.silent_s(now_ns)
        if self._intended_on is not False and silent_s >= self._parameters.interlock_lost_after_s:
            # Not reachable now: it is switched off as soon as it answers.
            self._latch(f"no answer from the supply for {silent_s:.0f} s: {error}")

    # Orders --------------------------------------------------------------------------------------

    def energise(
        self, author: str, *, voltage_v: float | None = None, current_limit_a: float | None = None
    ) -> None:
        """Switch the output on at a person's order, and close the interlock.

        Parameters
        ----------
        author
            Who ordered it.
        voltage_v, current_limit_a
            As configured where not given.

        Raises
        ------
        ValueError
            No author: nothing else may switch it on.
        InstrumentError
            The supply did not do it; the interlock stays as it was.
        """
        if not author.strip():
            raise ValueError("an order to energise needs its author")
        supply, parameters = self._supply, self._parameters
        voltage_v = parameters.voltage_v if voltage_v is None else voltage_v
        limit_a = parameters.current_limit_a if current_limit_a is None else current_limit_a
        now_ns = self._clock.mono_ns()
        self._supply_log.look_again_at_once(now_ns)
        try:
            supply.energise(voltage_v, limit_a)
        except InstrumentError:
            self._intended_on, self._must_read_back = None, True  # what it left is read, and taken as it is
            raise
        log.warning("output switched on by %s: %g V, at most %g A", author, voltage_v, limit_a)
        self._tripped, self._unwatched, self._must_switch_off = None, False, False
        self._intended_on, self._limit_a, self._high_readings = True, limit_a, 0
        self._ordered_ns = self._clock.mono_ns()

    def switch_off(self, author: str) -> None:
        """Switch the output off at a person's order; the interlock stays as it is.

        Raises
        ------
        ValueError
            No author.
        InstrumentError
            What the output does is unknown.
        """
        if not author.strip():
            raise ValueError("an order to switch off needs its author")
        self._supply_log.look_again_at_once(self._clock.mono_ns())
        self._supply.make_safe()
        log.warning("output switched off by %s", author)
        self._intended_on, self._must_switch_off = False, False

    def trip(self, reason: str, *, unwatched: bool = False) -> bool:
        """Open the interlock: switch off now, or as soon as the supply answers, and stay off.

        Parameters
        ----------
        unwatched
            Because nobody watched.

        Returns
        -------
        bool
            True if the output was read back as off; False if that is still owed.
        """
        self._unwatched = self._unwatched or unwatched
        self._latch(reason)
        return self._switch_off_now()

    def _latch(self, reason: str) -> None:
        if self._tripped is None:
            self._tripped = reason
            log.error("interlock tripped: %s", reason)
        self._intended_on, self._must_switch_off, self._high_readings = False, True, 0

    def _switch_off_now(self) -> bool:
        now_ns = self._clock.mono_ns()
        self._must_switch_off = True
        try:
            self._supply.make_safe()
        except InstrumentError as error:
            self._note_failure(error, now_ns)
            return False
        self._must_switch_off = False
        self._supply_log.look_again_at_once(now_ns)
        return True

    # What it says --------------------------------------------------------------------------------

    def output(self) -> SupplyState:
        """Output as last read; unknown as soon as the newest reading is not good."""
        if self._newest is None or self._supply_log.quality(self._clock.mono_ns()) != "good":
            return "unknown"
        return "on" if self._newest.output_on else "off"

    def conditions(self) -> tuple[DriveCondition, ...]:
        """Possible alarms of the supply, each with whether it stands."""
        now_ns = self._clock.mono_ns()
        quality, reading = self._supply_log.quality(now_ns), self._newest
        # A reading from before the order says nothing of how it was carried out.
        told = reading is not None and reading.stamp.mono_ns >= self._ordered_ns
        off = bool(self._intended_on) and reading is not None and told and not reading.output_on
        tolerance_a = self._parameters.readback_tolerance_a
        limited = (
            reading is not None and reading.output_on and reading.current_a >= self._limit_a - tolerance_a
        )
        causes, unknown = "", ""
        if isinstance(self._supply, TellsProtections):
            if tripped := self._supply.tripped_protections:
                causes = f" (tripped: {', '.join(tripped)})"
            if untold := self._supply.protection_unknown:
                unknown = f" (a protection may have tripped: {untold})"
        owed = "; the output could not be switched off yet" if self._must_switch_off else ""
        silent_s = self._supply_log.silent_s(now_ns)
        return (
            DriveCondition(
                name="supply_lost",
                active=quality == "lost",
                message=f"no reading for {silent_s:.0f} s, what the output does is unknown: "
                f"{self._supply_log.trouble}"
                if quality == "lost"
                else "the supply answers",
            ),
            DriveCondition(
                name="supply_off_unexpectedly",
                active=off,
                message="the output is off and nobody ordered that"
                + (causes or unknown)
                + "; find the cause, then order it on"
                if off
                else "the output is as ordered",
            ),
            DriveCondition(
                name="supply_limit",
                active=limited,
                message=f"the current is at its limit of {self._limit_a:g} A: the voltage is no longer held"
                if limited
                else "the current is below its limit",
            ),
            DriveCondition(
                name="interlock_tripped",
                active=self._tripped is not None,
                message=f"{self._tripped}{owed}" if self._tripped is not None else "the interlock is closed",
            ),
            DriveCondition(
                name="supply_unwatched",
                active=self._unwatched,
                message=f"{self._tripped}{owed}" if self._unwatched else "the supply is watched",
            ),
        )

    def begin_window(self, n_told: int | None = None) -> None:
        """Start the means anew, once the last row is stored; readings behind the ``n_told`` in it stay."""
        del self._window[:n_told]

    def row(self, set_index: int, due_h: float) -> EnvironmentRow:
        """Row of a set in ``environment``: means since `begin_window`, totals since hour 0."""
        now_ns, log_ = self._clock.mono_ns(), self._supply_log
        voltages_v = [reading.voltage_v for reading in self._window]
        currents_a = [reading.current_a for reading in self._window]
        # A silence that lasts is unknown time already, before a reading ends it.
        open_s = log_.silent_s(now_ns) if self._newest is not None and log_.too_old(now_ns) else 0.0
        return EnvironmentRow(
            set_index=set_index,
            due_h=due_h,
            supply_state=self.output(),
            supply_quality=log_.quality(now_ns),
            supply_age_s=log_.age_s(now_ns),
            supply_tripped=self._tripped,
            voltage_v=_mean(voltages_v),
            voltage_min_v=min(voltages_v, default=None),
            voltage_max_v=max(voltages_v, default=None),
            current_a=_mean(currents_a),
            current_min_a=min(currents_a, default=None),
            current_max_a=max(currents_a, default=None),
            charge_coulomb=self._charge.coulomb,
            unknown_s=self._charge.unknown_s + open_s,
            climate_quality="absent",
        )


def no_supply(set_index: int, due_h: float) -> EnvironmentRow:
    """Row of a set without a supply."""
    return EnvironmentRow(
        set_index=set_index,
        due_h=due_h,
        supply_state="absent",
        supply_quality="absent",
        climate_quality="absent",
    )


def summary(row: EnvironmentRow) -> dict[str, float | str | None]:
    """Columns of ``environment`` but for what says which set it is."""
    return {name: value for name, value in values(row).items() if name not in ("id", "set_index", "due_h")}


def _mean(numbers: Sequence[float]) -> float | None:
    return sum(numbers) / len(numbers) if numbers else None
