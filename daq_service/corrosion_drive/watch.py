"""Supply and climate in the recorder: read while it is idle, one row per set, alarms at once.

A `SupplyDrive` measures and switches, usually in the supply process; here its conditions become alarms in the
catalogue as soon as they change, so that an interlock trip between two sets is stored, also after a crash.
The climate probe is read here.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from daq_service.alarms.states import Condition, Moment
from daq_service.catalogue import Catalogue, SetCommit
from daq_service.catalogue.rows import AlarmRow, EnvironmentRow
from daq_service.corrosion_drive.charge import DriveState, restore_drive_state
from daq_service.corrosion_drive.climate import ClimateLog
from daq_service.corrosion_drive.drive import (
    CONDITIONS,
    DriveCondition,
    Reply,
    SupplyLogger,
    build_absent_row,
    select_columns,
)
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.errors import StorageError
from daq_service.settings.rig import RigSettings
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import DueSet

log = logging.getLogger(__name__)

PendingReply = Callable[[], str | None]
SupplyDrive = SupplyLogger | RemoteDrive
Alarms = Mapping[tuple[str | None, str], AlarmRow]


class DriveWatch:
    """Supply and climate of a running test.

    Parameters
    ----------
    alarms
        The recorder's current alarms by position and kind.
    update_alarm
        Updates an alarm by a condition, in a transaction.
    store
        Stores a transaction and takes over its alarms.
    remote
        Drive in the supply process; None: the rig's supply is driven here.
    """

    def __init__(
        self,
        settings: RigSettings,
        rig: Rig,
        catalogue: Catalogue,
        alarms: Alarms,
        update_alarm: Callable[[Condition, Moment, SetCommit], None],
        store: Callable[[SetCommit], None],
        remote: RemoteDrive | None = None,
    ) -> None:
        """Restore the supply's state from the catalogue; read neither supply nor climate probe.

        With ``remote`` that state is written for its process, unless one has written its own.
        """
        self._update_alarm = update_alarm
        self._store = store
        self._clock = rig.clock
        self._off_at_end = settings.driven is not None and settings.driven.off_at_end
        self._drive: SupplyDrive | None = remote
        if settings.driven is not None:
            state = _restore_last_state(settings.driven, catalogue, alarms)
            if remote is not None:
                remote.store_catalogue_state(state)
            elif rig.supply is not None:
                self._drive = SupplyLogger(rig.supply, rig.clock, settings.driven, state)
        self._climate = None
        if rig.climate is not None and settings.logged is not None:
            self._climate = ClimateLog(rig.climate, rig.clock, settings.logged)

    @property
    def has_supply(self) -> bool:
        """Return whether the test has a supply, driven here or in the supply process."""
        return self._drive is not None

    def tick(self, hour: float) -> None:
        """Read supply and climate probe if due, which blocks, and store changed alarms at this test hour.

        Instrument errors become alarms; an alarm that cannot be stored is logged and tried again.
        """
        if self._climate is not None:
            self._climate.tick()
        if self._drive is not None:
            self._drive.tick()
        self._update_alarms(hour)

    def _yield_conditions(self) -> Iterator[DriveCondition]:
        """Yield the conditions of climate probe and supply: name, values, and whether each is active."""
        if self._climate is not None:
            yield self._climate.build_condition()
        yield from () if self._drive is None else self._drive.list_conditions()

    def _update_alarms(self, hour: float) -> None:
        """Update each alarm of supply and climate by its present condition, in one transaction.

        Its time is now, at this test hour. Nothing is stored without a change. A StorageError is logged: the
        next tick tries again.
        """
        moment = Moment(utc_ns=self._clock.utc_ns(), due_h=hour, set_index=None)
        transaction = SetCommit()
        for drive_condition in self._yield_conditions():
            condition = Condition(
                kind=drive_condition.name,
                priority=CONDITIONS[drive_condition.name],
                present=drive_condition.active,
                evidence={**self.summarise_readings(), **drive_condition.values}
                if drive_condition.active
                else {},
            )
            self._update_alarm(condition, moment, transaction)
        if transaction.events:
            try:
                self._store(transaction)
            except StorageError as error:  # the next tick tries again, as the stored alarm is unchanged
                log.warning("an alarm of the drive is not stored yet: %s", error)

    # For the rows of a set -----------------------------------------------------------------------

    def summarise_readings(self) -> Mapping[str, float | str | None]:
        """Return the environment columns of supply and probe since the last stored set, by column name."""
        return select_columns(self._build_environment_row(0, 0.0))

    def add_environment_row(self, transaction: SetCommit, due: DueSet, moment: Moment) -> None:
        """Append the environment row of a set and its event to the transaction, and restart the means.

        The transaction is changed but not stored here.
        """
        transaction.environment.append(self._build_environment_row(due.set_index, due.due_h))
        transaction.events.append(moment.event("environment", "environment_read", {}))
        if self._drive is not None:
            self._drive.restart_means()

    def _build_environment_row(self, set_index: int, due_h: float) -> EnvironmentRow:
        """Build the environment row of a set, due at test hour ``due_h``.

        A missing supply or climate probe is marked as absent.
        """
        row = (build_absent_row if self._drive is None else self._drive.build_row)(set_index, due_h)
        return row if self._climate is None else self._climate.add_climate_to_row(row)

    # Commands ------------------------------------------------------------------------------------

    def supply_on(
        self, author: str, hour: float, *, voltage_v: float | None, current_limit_a: float | None
    ) -> PendingReply:
        """Command the supply on for a person, with voltage in V and current limit in A; None: as configured.

        Return a function that polls the reply; both raise ValueError as `_send_command` describes. ``hour``
        is the test hour of the command.
        """

        def energise(drive: SupplyDrive) -> Reply:
            """Command the output on with the given voltage (V) and current limit (A); return its reply.

            Errors of the drive pass through.
            """
            return drive.energise(author, voltage_v=voltage_v, current_limit_a=current_limit_a)

        done, failed = "the supply is on, read back as commanded", "the supply was not switched on: {error}"
        return self._send_command(energise, hour, done, failed)

    def supply_off(self, author: str, hour: float) -> PendingReply:
        """Command the supply off for a person at test hour ``hour``; return a function that polls the reply.

        Both raise ValueError as `_send_command` describes.
        """
        done, failed = "the supply is off, read back", "the supply may be on: {error}; switch it off by hand"
        return self._send_command(lambda drive: drive.switch_off(author), hour, done, failed)

    def _send_command(
        self, command: Callable[[SupplyDrive], Reply], hour: float, done: str, failed: str
    ) -> PendingReply:
        """Send a command to the supply; return a function that polls its reply.

        The function returns None before the reply and ``done`` after success, when alarms are updated at test
        hour ``hour``.

        Raises
        ------
        ValueError
            The command has no author. The returned function raises it, with the text ``failed``, where the
            command failed or could not be sent.
        """
        assert self._drive is not None, "a test without a supply forbids the command"
        try:
            reply = command(self._drive)
        except InstrumentError as error:
            reply = Reply(error=str(error))

        def poll_reply() -> str | None:
            """Return ``done`` after success, alarms updated; None before it; ValueError after a failure."""
            if reply.error:
                raise ValueError(failed.format(error=reply.error))
            if not reply.done:
                return None
            self._update_alarms(hour)
            return done

        return poll_reply

    def trip(self, reason: str, hour: float) -> None:
        """Trip the interlock for a possible hole, and store its alarm at this test hour.

        Nothing happens without a supply. The output is off at once or as soon as the supply responds.
        """
        if self._drive is not None:
            self._drive.trip(reason)
            self._update_alarms(hour)

    def switch_off_at_end(self) -> str:
        """Switch the supply off at the end of a test if ``off_at_end``; return the result as text.

        Empty if nothing was done. An InstrumentError is logged and part of the text, not raised. May block.
        """
        if not self._off_at_end or self._drive is None:
            return ""
        try:
            self._drive.switch_off_at_end()
        except InstrumentError as error:
            log.error("the supply may still be on, switch it off by hand: %s", error)
            return f"the supply may still be on, switch it off by hand: {error}"
        return "the supply is off"


def _restore_last_state(supply: DriveParameters, catalogue: Catalogue, alarms: Alarms) -> DriveState:
    """Restore the supply's state from the newest environment row; return the default state without one.

    The interlock is restored as tripped only by an active alarm ``interlock_tripped``, with its reason.
    """
    state, row = DriveState(), catalogue.read_last_environment()
    last_event = None if row is None else catalogue.read_last_event("environment")
    if last_event is not None:
        state = restore_drive_state(row, written_utc_ns=last_event.utc_ns, parameters=supply)
    tripped = alarms.get((None, "interlock_tripped"))
    is_active = tripped is not None and tripped.state in ("unacknowledged", "acknowledged")
    reason = None if tripped is None else tripped.evidence.get("trip_reason") or tripped.message
    return replace(state, tripped=reason if is_active else None)
