"""The electrochemical drive: a DC supply that understands SCPI-1999 on a serial line.

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
from hardware_drivers.serial_port.instrument import SerialInstrument
from hardware_drivers.serial_port.parameters import ORDER_REPLIES, SupplyParameters

log = logging.getLogger(__name__)

ERROR_QUEUE_LENGTH = 32
"""SCPI queues hold some 20 entries; one that never empties is a fault."""


class ScpiPowerSupply(SerialInstrument[SupplyParameters]):
    """A `PowerSupply` of the instrument Protocols."""

    _tripped: tuple[str, ...] = ()

    @property
    def tripped_protections(self) -> tuple[str, ...]:
        """Protections found tripped when the output was last found off, by the question asked."""
        return self._tripped

    def read(self, timeout_s: float) -> SupplyReading:
        """Measure voltage and current and ask whether the output is on.

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
        """Tell what is set: voltage, current limit, output and tripped protections; changes nothing.

        Raises
        ------
        BusyError, ConfigurationError, ConnectionLostError
            As for `read`.
        """
        deadline_s = self._deadline_s(timeout_s)
        self._connect(deadline_s)
        self._tripped = self._ask_protections(deadline_s)
        return {
            "set_voltage_v": self._line.query_number("VOLT?", deadline_s),
            "set_current_limit_a": self._line.query_number("CURR?", deadline_s),
            "output": "on" if self._line.query_flag("OUTP?", deadline_s) else "off",
            "tripped": ", ".join(self._tripped),
        }

    def energise(self, voltage_v: float, current_limit_a: float) -> None:
        """Switch off, set, read back, then switch on and measure; on any doubt the output is off again.

        Raises
        ------
        ConfigurationError
            Beyond the caps (nothing was sent), a protection has tripped, or the supply refused or did
            not keep what was set: the output is off.
        BusyError
            Another program owns the port; nothing was sent.
        ConnectionLostError
            The supply does not answer; the message says what is known of its output.
        """
        self._require_within_caps(voltage_v, current_limit_a)
        deadline_s = self._deadline_s(ORDER_REPLIES * self._parameters.line.reply_timeout_s)
        try:
            self._connect(deadline_s, at_once=True)
            self._require_no_protection_tripped(deadline_s)
        except InstrumentError as error:
            raise type(error)(f"{error}; the output was left as it was") from error
        try:
            self._switch_off(deadline_s)
            self._drain_errors(deadline_s)  # what was wrong before is not this order's fault
            self._set(voltage_v, current_limit_a, deadline_s)
            self._line.send("OUTP ON")
            self._require_no_error("switch its output on", deadline_s)
            self._require_sound(voltage_v, current_limit_a, deadline_s)
        except InstrumentError as error:
            try:
                self.make_safe()
            except ConnectionLostError as unsafe:
                raise ConnectionLostError(f"{error}; and {unsafe}") from error
            raise type(error)(f"{error}; the output is off") from error

    def make_safe(self) -> None:
        """Switch the output off and read that back.

        Raises
        ------
        ConnectionLostError
            That could not be done, whatever the reason: what the output does is unknown.
        """
        deadline_s = self._deadline_s(ORDER_REPLIES * self._parameters.line.reply_timeout_s)
        try:
            # A line that looks open may be dead: then one fresh attempt.
            if self._line.connected:
                try:
                    self._switch_off(deadline_s)
                    return
                except ConnectionLostError as error:
                    log.warning("switching off: %s; trying once more", error)
            self._connect(deadline_s, at_once=True)
            self._switch_off(deadline_s)
        except InstrumentError as error:
            raise ConnectionLostError(
                f"the supply could not be switched off, what its output does is unknown: {error}"
            ) from error

    # Steps ---------------------------------------------------------------------------------------

    def _connect(self, deadline_s: float, *, at_once: bool = False) -> None:
        if self._line.connect(deadline_s, at_once=at_once) and self._parameters.setup_commands:
            for command in self._parameters.setup_commands:
                self._line.send(command)
            for entry in self._drain_errors(deadline_s):
                log.warning("%s after the setup commands: %s", self._line.name, entry)

    def _measure(self, deadline_s: float) -> SupplyReading:
        voltage_v = self._line.query_number("MEAS:VOLT?", deadline_s)
        stamp = self._stamp()
        current_a = self._line.query_number("MEAS:CURR?", deadline_s)
        output_on = self._line.query_flag("OUTP?", deadline_s)
        self._tripped = () if output_on else self._ask_protections(deadline_s)
        return SupplyReading(stamp=stamp, voltage_v=voltage_v, current_a=current_a, output_on=output_on)

    def _switch_off(self, deadline_s: float) -> None:
        self._line.send("OUTP OFF")
        if self._line.query_flag("OUTP?", deadline_s):
            raise self._line.refused("was told to switch its output off and says it is on")

    def _set(self, voltage_v: float, current_limit_a: float, deadline_s: float) -> None:
        """Limit first, so that a voltage never stands with another order's limit."""
        parameters = self._parameters
        for command, value, unit, tolerance in (
            ("CURR", current_limit_a, "A", parameters.readback_tolerance_a),
            ("VOLT", voltage_v, "V", parameters.readback_tolerance_v),
        ):
            self._line.send(f"{command} {value:.6g}")
            self._require_no_error(f"take {command} {value:g}", deadline_s)
            told = self._line.query_number(f"{command}?", deadline_s)
            if abs(told - value) > tolerance:
                raise ConfigurationError(
                    f"{self._line.name} was set to {value:g} {unit} and reads back {told:g} {unit}: more "
                    f"than {tolerance:g} {unit} off; check its range and its lock"
                )

    def _require_sound(self, voltage_v: float, current_limit_a: float, deadline_s: float) -> None:
        """Look at what the output does once it is on; a drop below the voltage is the limit at work."""
        parameters = self._parameters
        reading = self._measure(deadline_s)
        if not reading.output_on:
            causes = ", ".join(self._tripped) or "it does not say why"
            raise ConfigurationError(f"{self._line.name} switched itself off again ({causes})")
        for measured, most, unit in (
            (reading.voltage_v, voltage_v + parameters.readback_tolerance_v, "V"),
            (reading.current_a, current_limit_a + parameters.readback_tolerance_a, "A"),
        ):
            if measured > most:
                raise ConfigurationError(
                    f"{self._line.name} gives {measured:g} {unit}; at most {most:g} {unit} was asked for"
                )

    def _require_within_caps(self, voltage_v: float, current_limit_a: float) -> None:
        parameters = self._parameters
        for name, value, cap_name, cap in (
            ("voltage_v", voltage_v, "voltage_cap_v", parameters.voltage_cap_v),
            ("current_limit_a", current_limit_a, "current_cap_a", parameters.current_cap_a),
        ):
            if not 0.0 < value <= cap:
                raise ConfigurationError(
                    f"{name} is {value:g}; it must be above 0 and at most {cap_name} = {cap:g}; "
                    "nothing was sent"
                )

    def _require_no_protection_tripped(self, deadline_s: float) -> None:
        self._tripped = self._ask_protections(deadline_s)
        if self._tripped:
            raise ConfigurationError(
                f"{self._line.name} has tripped ({', '.join(self._tripped)}); find the cause, clear the "
                "protection at the instrument, then order again"
            )

    def _ask_protections(self, deadline_s: float) -> tuple[str, ...]:
        asked = self._parameters.protection_queries
        return tuple(question for question in asked if self._line.query_flag(question, deadline_s))

    def _require_no_error(self, doing: str, deadline_s: float) -> None:
        entries = self._drain_errors(deadline_s)
        if entries:
            raise ConfigurationError(f"{self._line.name} refused to {doing}: {'; '.join(entries)}")

    def _drain_errors(self, deadline_s: float) -> list[str]:
        entries: list[str] = []
        while (entry := self._line.query_error(deadline_s)) is not None:
            entries.append(entry)
            if len(entries) == ERROR_QUEUE_LENGTH:
                raise self._line.refused(f"has an error queue that does not end: {entry}")
        return entries
