"""Corrosion supply: a DC supply that uses one of the `dialects`.

Only `energise` switches the output on, and only a person's order calls it. A link that was lost is
opened again by the next call, which checks the name and reads the state: nothing is set, nothing
switched. Deadlines run on the machine's monotonic time; stamps and the waits between attempts to
reach the supply come from the caller's ``stamp``.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

from hardware_drivers.errors import ConfigurationError, ConnectionLostError, InstrumentError
from hardware_drivers.measurement import SupplyReading
from hardware_drivers.serial_port.dialects import Dialect, Flag, Level, Number, build_channel_dialect
from hardware_drivers.serial_port.instrument import SerialInstrument
from hardware_drivers.serial_port.parameters import ORDER_REPLIES, SupplyParameters

log = logging.getLogger(__name__)

ERROR_QUEUE_LENGTH = 32
"""SCPI queues hold some 20 entries; one that never empties is a fault."""
UNDEFINED_HEADER = -113
"""SCPI-1999, 21.8.9: the instrument does not know the command."""


class ScpiPowerSupply(SerialInstrument[SupplyParameters]):
    """Power supply with a text protocol; a `PowerSupply` of the instrument Protocols."""

    _tripped: tuple[str, ...] = ()
    _undefined: frozenset[str] = frozenset()

    @property
    def tripped_protections(self) -> tuple[str, ...]:
        """Return the protections found tripped when the output was last found off; empty while it is on."""
        return self._tripped

    @property
    def protection_unknown(self) -> str:
        """Return the reason why a trip may stay unreported; empty where the supply reports trips."""
        if not (protections := self._list_protections()):
            return f"dialect {self._parameters.dialect} asks no protection whether it has tripped"
        unknown = ", ".join(flag.ask for flag in protections if flag.ask in self._undefined)
        return f"the supply does not know {unknown}" if unknown else ""

    def read(self, timeout_s: float) -> SupplyReading:
        """Measure voltage in V and current in A, and query the output state, within ``timeout_s``.

        The stamp is that of the current, which is what is integrated.

        Raises
        ------
        BusyError
            Another program owns the port.
        ConfigurationError
            Another instrument is there, or the port cannot be opened as configured.
        ConnectionLostError
            The supply does not answer in time or nonsense: what its output does is unknown.
        """
        deadline_s = self._deadline_s(timeout_s)
        self._connect(deadline_s)
        return self._measure(deadline_s)

    def read_back(self, timeout_s: float) -> Mapping[str, float | str]:
        """Query settings, output and tripped protections, and return them by name; nothing is changed.

        ``set_voltage_v`` and ``set_current_limit_a`` are numbers (V, A), ``output`` is ``on`` or ``off``;
        ``tripped`` and ``protection_unknown`` are texts, empty if there is nothing to report.

        Raises
        ------
        BusyError, ConfigurationError, ConnectionLostError
            As for `read`.
        """
        deadline_s = self._deadline_s(timeout_s)
        self._connect(deadline_s)
        self._tripped = self._query_protections(deadline_s)
        return {
            "set_voltage_v": self._query_number(self._dialect.voltage.read, deadline_s),
            "set_current_limit_a": self._query_number(self._dialect.current.read, deadline_s),
            "output": "on" if self._query_flag(self._dialect.output, deadline_s) else "off",
            "tripped": ", ".join(self._tripped),
            "protection_unknown": self.protection_unknown,
        }

    def energise(self, voltage_v: float, current_limit_a: float) -> None:
        """Switch off, set voltage (V) and limit (A), read back, then switch on and measure.

        If any step after the first switch-off fails, the output is switched off again.

        Raises
        ------
        ConfigurationError
            Beyond the caps (nothing was sent), a protection has tripped (output as before), or the supply
            refused or did not keep what was set: the output is off.
        BusyError
            Another program owns the port; nothing was sent.
        ConnectionLostError
            The supply does not answer; the message states what is known of its output.
        """
        self._parameters.require_within_caps(voltage_v, current_limit_a)
        deadline_s = self._deadline_s(ORDER_REPLIES * self._parameters.line.reply_timeout_s)
        try:
            self._connect(deadline_s, at_once=True)
            self._require_no_protection_tripped(deadline_s)
        except InstrumentError as error:
            raise type(error)(f"{error}; the output was left as it was") from error
        try:
            self._switch_off(deadline_s)
            self._drain_errors(deadline_s)  # what was wrong before is not this order's fault
            self._set_output_levels(voltage_v, current_limit_a, deadline_s)
            if self.protection_unknown:
                log.warning("%s is switched on, though %s", self._line.name, self.protection_unknown)
            self._line.send(self._dialect.switch_on)
            self._require_no_error("switch its output on", deadline_s)
            self._check_output(voltage_v, current_limit_a, deadline_s)
        except InstrumentError as error:
            try:
                self.make_safe()
            except ConnectionLostError as unsafe:
                raise ConnectionLostError(f"{error}; and {unsafe}") from error
            raise type(error)(f"{error}; the output is off") from error

    def make_safe(self) -> None:
        """Switch the output off and read that back; if the line is dead, connect again and try once more.

        Raises
        ------
        ConnectionLostError
            That could not be done, for any reason: the state of the output is unknown.
        """
        deadline_s = self._deadline_s(ORDER_REPLIES * self._parameters.line.reply_timeout_s)
        try:
            # A line that looks open may be dead: then one fresh attempt.
            if self._line.in_step:
                try:
                    self._switch_off(deadline_s)
                    return
                except ConnectionLostError as error:
                    log.warning("switching off: %s; trying again", error)
            self._connect(deadline_s, at_once=True)
            self._switch_off(deadline_s)
        except InstrumentError as error:
            raise ConnectionLostError(
                f"the supply could not be switched off, what its output does is unknown: {error}"
            ) from error

    # Steps ---------------------------------------------------------------------------------------

    @property
    def _dialect(self) -> Dialect:
        """Return the commands of this supply's dialect for the configured channel."""
        return build_channel_dialect(self._parameters.dialect, self._parameters.channel)

    @property
    def _name_pattern(self) -> str:
        """Return the dialect's pattern of the response to the identity query, with named groups."""
        return self._dialect.name

    def _list_protections(self) -> tuple[Flag, ...]:
        """Return the configured queries of tripped protections, else the dialect's; empty: none is sent."""
        given = self._parameters.protection_queries
        return self._dialect.protections if given is None else tuple(Flag(ask=query) for query in given)

    def _query_number(self, number: Number, deadline_s: float) -> float:
        """Query a number in its SI unit; ConnectionLostError for anything else or at ``deadline_s``."""
        return self._line.query_number(
            number.ask, deadline_s, units=(number.unit,), header=number.header, stray=number.stray
        )

    def _query_flag(self, flag: Flag, deadline_s: float) -> bool:
        """Query yes (True) or no; ConnectionLostError for any other response or at ``deadline_s``."""
        return self._line.query_flag(flag.ask, deadline_s, mask=flag.mask, raw=flag.raw)

    def _connect(self, deadline_s: float, *, at_once: bool = False) -> None:
        """Connect and, newly in step, send the setup commands; log their errors as warnings."""
        for entry in self._connect_and_set_up(deadline_s, at_once=at_once):
            log.warning("%s after the setup commands: %s", self._line.name, entry)

    def _connect_and_set_up(self, deadline_s: float, *, at_once: bool) -> list[str]:
        """Connect and, newly in step, send the setup commands; return the errors they cause, else none."""
        if not self._line.connect(deadline_s, at_once=at_once) or not self._parameters.setup_commands:
            return []
        for command in self._parameters.setup_commands:
            self._line.send(command)
        return self._drain_errors(deadline_s)

    def _measure(self, deadline_s: float) -> SupplyReading:
        """Measure voltage and current and query the output; if it is off, query the protections too.

        The stamp is read between voltage and current. The names of tripped protections are stored.
        ConnectionLostError without a valid response by the deadline.
        """
        voltage_v = self._query_number(self._dialect.measured_voltage, deadline_s)
        stamp = self._stamp()
        current_a = self._query_number(self._dialect.measured_current, deadline_s)
        output_on = self._query_flag(self._dialect.output, deadline_s)
        self._tripped = () if output_on else self._query_protections(deadline_s)
        return SupplyReading(stamp=stamp, voltage_v=voltage_v, current_a=current_a, output_on=output_on)

    def _switch_off(self, deadline_s: float) -> None:
        """Switch the output off; ConnectionLostError if it then reports on, or does not answer."""
        self._line.send(self._dialect.switch_off)
        if self._query_flag(self._dialect.output, deadline_s):
            raise self._line.mark_lost("was commanded to switch its output off and reports that it is on")

    def _set_output_levels(self, voltage_v: float, current_limit_a: float, deadline_s: float) -> None:
        """Set protection levels, current limit, then voltage (V, A), each read back as by `_set_level`.

        The limit comes first, so that a voltage never meets the limit of an earlier command. With an
        over-voltage level the voltage is set to 0 V before all.
        """
        parameters, dialect = self._parameters, self._dialect
        if parameters.over_voltage_v is not None:
            # Some supplies refuse a protection below the voltage that was set, or a voltage above the
            # protection that was: from nothing each step is allowed.
            self._set_level(dialect.voltage, 0.0, deadline_s)
        for level, value in (
            (dialect.over_voltage, parameters.over_voltage_v),
            (dialect.over_current, parameters.over_current_a),
            (dialect.current, current_limit_a),
            (dialect.voltage, voltage_v),
        ):
            if level is not None and value is not None:
                self._set_level(level, value, deadline_s)

    def _set_level(self, level: Level, value: float, deadline_s: float) -> None:
        """Set a level in V or A and the switch that enables it, and read both back.

        Raise ConfigurationError if the supply reports an error, the level differs by more than the tolerance,
        or the switch reads off; ConnectionLostError if it does not answer.
        """
        parameters, unit = self._parameters, level.read.unit
        tolerance = parameters.readback_tolerance_v if unit == "V" else parameters.readback_tolerance_a
        for command in (f"{level.command}{value:{level.digits}}", level.enable):
            if command:
                self._line.send(command)
                self._require_no_error(f"take {command}", deadline_s)
        actual = self._query_number(level.read, deadline_s)
        if abs(actual - value) > tolerance:
            raise ConfigurationError(
                f"{self._line.name} was set to {value:g} {unit} and reads back {actual:g} {unit}: more "
                f"than {tolerance:g} {unit} off; check its range and its lock"
            )
        if level.enabled is not None and not self._query_flag(level.enabled, deadline_s):
            raise ConfigurationError(
                f"{self._line.name} received {level.enable} and reports that it is off; check its lock"
            )

    def _check_output(self, voltage_v: float, current_limit_a: float, deadline_s: float) -> None:
        """Measure after switching on; ConfigurationError if off, or above set values plus tolerance."""
        parameters = self._parameters
        reading = self._measure(deadline_s)
        if not reading.output_on:
            causes = ", ".join(self._tripped) or "the supply does not report the cause"
            raise ConfigurationError(f"{self._line.name} switched itself off again ({causes})")
        for measured, most, unit in (
            (reading.voltage_v, voltage_v + parameters.readback_tolerance_v, "V"),
            (reading.current_a, current_limit_a + parameters.readback_tolerance_a, "A"),
        ):
            if measured > most:
                raise ConfigurationError(
                    f"{self._line.name} gives {measured:g} {unit}; at most {most:g} {unit} was asked for"
                )

    def _require_no_protection_tripped(self, deadline_s: float) -> None:
        """Raise ConfigurationError with the names of tripped protections; trips as events are forgotten."""
        self._tripped = tripped = self._query_protections(deadline_s)
        if tripped:
            if self._dialect.trips_are_events:
                # Nothing will tell that it was cleared: the next order is the person's word.
                self._tripped = ()
            raise ConfigurationError(
                f"{self._line.name} has tripped ({', '.join(tripped)}); find the cause, clear the "
                "protection at the instrument, then order again"
            )

    def _query_protections(self, deadline_s: float) -> tuple[str, ...]:
        """Query the protections and return the names of those that have tripped.

        A query that the supply reports as undefined is logged and never sent again: that protection is
        unknown. Where trips are events, those found before are kept. ConnectionLostError for other failures.
        """
        tripped = list(self._tripped) if self._dialect.trips_are_events else []
        for flag in self._list_protections():
            if flag.ask in self._undefined:
                continue
            try:
                has_tripped = self._query_flag(flag, deadline_s)
            except ConnectionLostError as error:
                # An instrument does not answer what it does not know. Only its own word separates that from a
                # lost line, and then the protection is reported as unknown, never as sound.
                if not self._was_query_undefined(deadline_s):
                    raise
                self._undefined |= {flag.ask}
                log.warning("%s; it reports an undefined command: that protection is unknown", error)
                continue
            if has_tripped and (name := flag.name or flag.ask) not in tripped:
                tripped.append(name)
        return tuple(tripped)

    def _was_query_undefined(self, deadline_s: float) -> bool:
        """Connect again, empty the error queue, and return whether it has `UNDEFINED_HEADER`."""
        entries = self._connect_and_set_up(deadline_s, at_once=True) + self._drain_errors(deadline_s)
        return any(int(entry.partition(",")[0]) == UNDEFINED_HEADER for entry in entries)

    def _require_no_error(self, doing: str, deadline_s: float) -> None:
        """Empty the error queue; if it has entries, raise ConfigurationError with them and ``doing``."""
        entries = self._drain_errors(deadline_s)
        if entries:
            raise ConfigurationError(f"{self._line.name} refused to {doing}: {'; '.join(entries)}")

    def _drain_errors(self, deadline_s: float) -> list[str]:
        """Read and return all entries of the supply's error queue, oldest first; it is empty afterwards.

        The list is empty where the dialect has no such query. Raise ConnectionLostError after
        `ERROR_QUEUE_LENGTH` entries.
        """
        entries: list[str] = []
        query, bare = self._dialect.error_query, self._dialect.bare_errors
        while query and (entry := self._line.query_error(query, deadline_s, bare=bare)) is not None:
            entries.append(entry)
            if len(entries) == ERROR_QUEUE_LENGTH:
                raise self._line.mark_lost(f"has an error queue that does not end: {entry}")
        return entries
