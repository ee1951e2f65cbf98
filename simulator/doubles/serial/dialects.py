"""Supply doubles with other command sets, each written from its maker's manual, not from the driver.

Aim-TTi: PL-P and MX series instruction manuals; answers carry headers and units, trips are events of the
limit register, which reading clears, and errors a register of one number. Korad: KA3000 remote control
syntax V2.0; no command and no answer has an end, and the status is one byte. Rigol: DP800 programming
guide; channels are named in each command, flags are ON, OFF, YES and NO.
"""

from __future__ import annotations

import re
from typing import ClassVar

from simulator.doubles.serial.link import Framing
from simulator.doubles.serial.supply import CONFLICT, NO_ERROR, OUT_OF_RANGE, UNDEFINED, Supply

QUANTITY = {"V": "VOLT", "I": "CURR"}
UNIT = {"VOLT": "V", "CURR": "A"}


class AimTtiSupply(Supply):
    """Output 1 of an Aim-TTi supply."""

    IDENTITY = "THURLBY THANDAR, PL303-P, 279730, 4.06-4.06"
    _EXECUTION_ERRORS: ClassVar = {OUT_OF_RANGE: "100", CONFLICT: "104"}

    def _set_power_on_state(self) -> None:
        """Restore the state after power-on, and clear the limit event register."""
        super()._set_power_on_state()
        self._events = 0

    def trip(self, protection: str = "CURR") -> None:
        """Trip the VOLT or CURR protection (output off), and set its bit in the limit event register."""
        super().trip(protection)
        self._events |= {"VOLT": 4, "CURR": 8}[protection]

    def _answer(self, question: str) -> str | None:
        """Return the answer to a query in Aim-TTi's syntax; None if it is unknown.

        Reading LSR1 clears its trip bits; reading EER removes the oldest error.
        """
        if question == "*IDN?":
            return self.identity
        if question == "EER?":
            return self._EXECUTION_ERRORS[self._errors.pop(0)] if self._errors else "0"
        if question == "OP1?":
            return str(int(self._on))
        if question == "LSR1?":
            events, self._events = self._events, 0
            return str(events | int(self._on))  # bit 0: holds its voltage
        if found := re.fullmatch(r"([VI])1(O?)\?", question):
            quantity = QUANTITY[found[1]]
            if found[2]:
                measured = self._compute_output()[quantity == "CURR"] + self._draw_noise(UNIT[quantity])
                return f"{measured:.3f}{UNIT[quantity]}" if quantity == "VOLT" else f"{measured:.4f}A"
            return f"{found[1]}1 {self._set[quantity]:.{3 if quantity == 'VOLT' else 4}f}"
        if found := re.fullmatch(r"O([VC])P1\?", question):
            return f"{found[1]}P1 {self._protection['VOLT' if found[1] == 'V' else 'CURR']:.2f}"
        return None

    def _execute_command(self, header: str, argument: str) -> str | None:
        """Execute a command in Aim-TTi's syntax; return its error, None without one or if it is unknown.

        Raises
        ------
        ValueError
            The level of a protection is no number.
        """
        if header in {"V1", "I1"}:
            return self._set_level(QUANTITY[header[0]], argument)
        if header in {"OVP1", "OCP1"}:
            return self._set_protection("VOLT" if header[1] == "V" else "CURR", float(argument))
        if header == "OP1":
            if argument == "1" and any(self._tripped.values()):
                return CONFLICT
            self._set_output(argument == "1", "command")
        elif header == "TRIPRST":
            self._tripped = dict.fromkeys(self._tripped, False)
        return None  # a command error is a bit of another register


class KoradSupply(Supply):
    """KA3005P: it reports no errors and no trips, and ignores invalid commands."""

    IDENTITY = "KORADKA3005PV2.0"
    FRAMING = Framing(
        commands=re.compile(rb"\*IDN\?|STATUS\?|[VI](?:SET|OUT)1\?|VSET1:\d+\.\d{2}|ISET1:\d\.\d{3}|OUT[01]"),
        reply_end=b"",
    )

    def answer(self, command: str) -> str | None:
        """Execute one command in Korad's syntax; return the response to a query, else None.

        Invalid values, and switching on after a trip, are ignored without an error, as the instrument does.
        """
        if command == "*IDN?":
            return self.identity
        if command == "STATUS?":
            return chr(0x40 * self._on | 0x01)  # bit 0: holds its voltage
        if command.startswith("OUT"):
            if command == "OUT0" or not any(self._tripped.values()):
                self._set_output(command == "OUT1", "command")
            return None
        quantity, form = QUANTITY[command[0]], "05.2f" if command[0] == "V" else ".3f"
        if not command.endswith("?"):
            self._set_level(quantity, command.partition(":")[2])
            return None
        if command[1:4] == "SET":  # firmware 2.0 appends a sixth character to the current
            return f"{self._set[quantity]:{form}}" + ("K" if quantity == "CURR" else "")
        return f"{self._compute_output()[quantity == 'CURR'] + self._draw_noise(UNIT[quantity]):{form}}"


class RigolSupply(Supply):
    """Channel 1 of a DP832."""

    IDENTITY = "RIGOL TECHNOLOGIES,DP832A,DP8B000001,00.01.16"
    _WORDS: ClassVar = {"OVP": "VOLT", "OCP": "CURR"}

    def _set_power_on_state(self) -> None:
        """Restore the state after power-on, with both protections disabled."""
        super()._set_power_on_state()
        self._guarded = {"VOLT": False, "CURR": False}

    def answer(self, command: str) -> str | None:
        """Execute one SCPI command; return the response to a query, else None.

        Errors enter the error queue; only a level of a protection that is no number raises ValueError.
        """
        header, _, argument = command.upper().partition(" ")
        if not header.endswith("?"):
            error = self._execute_command(header, argument)
            self._errors += [] if error is None else [error]
            return None
        response = self._answer_question(header, argument)
        if response is None:
            self._errors.append(UNDEFINED)
        return response

    def _answer_question(self, question: str, channel: str) -> str | None:
        """Return the answer to a query about channel CH1; None if query or channel is unknown.

        ``:SYST:ERR?`` removes the oldest error from the queue.
        """
        if question == "*IDN?":
            return self.identity
        if question == ":SYST:ERR?":
            return (self._errors.pop(0) if self._errors else NO_ERROR).lstrip("+")
        if found := re.fullmatch(r":SOUR1:(VOLT|CURR)\?", question):
            return f"{self._set[found[1]]:.{3 if found[1] == 'VOLT' else 4}f}"
        if channel != "CH1":
            return None
        if found := re.fullmatch(r":MEAS:(VOLT|CURR)\?", question):
            return f"{self._compute_output()[found[1] == 'CURR'] + self._draw_noise(UNIT[found[1]]):.4f}"
        if question == ":OUTP?":
            return "ON" if self._on else "OFF"
        if found := re.fullmatch(r":OUTP:(OVP|OCP)(:VAL|:QUES|)\?", question):
            quantity = self._WORDS[found[1]]
            return {
                ":VAL": f"{self._protection[quantity]:.3f}",
                ":QUES": "YES" if self._tripped[quantity] else "NO",
                "": "ON" if self._guarded[quantity] else "OFF",
            }[found[2]]
        return None

    def _execute_command(self, header: str, argument: str) -> str | None:
        """Execute a command for channel CH1; return its SCPI error, None if there is none.

        Raise ValueError if the level of a protection is no number.
        """
        if found := re.fullmatch(r":SOUR1:(VOLT|CURR)", header):
            return self._set_level(found[1], argument)
        channel, _, value = argument.partition(",")
        if channel != "CH1":
            return UNDEFINED
        if header == ":OUTP":
            if value == "ON" and any(self._tripped.values()):
                return CONFLICT
            self._set_output(value == "ON", "command")
        elif found := re.fullmatch(r":OUTP:(OVP|OCP)(:VAL|)", header):
            if found[2]:
                return self._set_protection(self._WORDS[found[1]], float(value))
            self._guarded[self._WORDS[found[1]]] = value == "ON"
        else:
            return UNDEFINED
        return None


SUPPLIES: dict[str, type[Supply]] = {
    "scpi": Supply,
    "aim_tti": AimTtiSupply,
    "korad": KoradSupply,
    "rigol": RigolSupply,
}
"""By the dialect that each speaks."""
