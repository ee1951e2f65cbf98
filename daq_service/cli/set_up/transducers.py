"""Set up transducers one by one, on instruments of any kind: wiring, checks, strikes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from analysis.errors import AnalysisError
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.init import read_lab_config
from daq_service.errors import BusyError, UsageError
from daq_service.settings.tables import KeyPath, Tables
from hardware_drivers.errors import InstrumentError

Contents = tuple[Tables, set[KeyPath], str]
"""Values, switched-off tables and head of a new file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flags:
    """Answers given as options; with a transducer among them nothing is asked."""

    transducers: Mapping[str, str] = field(default_factory=dict)
    probes: Mapping[str, str] = field(default_factory=dict)
    supply: str = ""
    climate: str = ""
    drop_height_m: float | None = None
    pulse_s: float | None = None
    strike: bool = False


class Instruments(Protocol):
    """Instruments of one kind, as the dialogue sets them up."""

    @property
    def wired(self) -> Mapping[str, object]:
        """Return the wiring of the transducers by position; empty before the first."""
        ...

    def read_shared_values(self, flags: Flags, *, asks: bool) -> None:
        """Print the instruments, and read or (if ``asks``) ask for the values that all transducers share.

        Raises UsageError if the answers end.
        """

    def wire(self, position: str, text: str) -> None:
        """Wire a transducer as an option states.

        Raises ValueError if that is impossible, InstrumentError if an instrument fails.
        """

    def ask_wiring(self, position: str) -> None:
        """Ask for the wiring of a transducer until it works; raise UsageError if the answers end."""

    def check(self) -> None:
        """Check and print whether the wired transducers can work; UsageError for incomplete settings."""

    def strike(self, position: str) -> None:
        """Strike once and print the result.

        Raises BusyError if a recorder owns the data folder, InstrumentError or AnalysisError if no record can
        be assessed.
        """

    def strike_each(self, positions: Collection[str]) -> None:
        """Strike each transducer without a question; raise the errors of `strike`."""

    def propose_from_strikes(self, *, asks: bool) -> None:
        """Propose values of the configuration from the strikes, and ask to accept them if ``asks``.

        Raises RigError if the values do not go together, UsageError if the answers end.
        """

    def contents(self, others: Tables, off: set[KeyPath]) -> Contents:
        """Return values, switched-off tables and head of the file; `others` are tables of [rig].

        ``off`` are further tables to switch off. Raises UsageError for invalid values.
        """
        ...

    def result(self) -> Mapping[str, object]:
        """Return the object that ``--json`` prints: instruments, wiring, strikes."""
        ...


def set_up_transducers(dialogue: Dialogue, instruments: Instruments, flags: Flags) -> None:
    """Wire and strike the transducers of the options; without any, ask for them until the person ends.

    Raises
    ------
    UsageError
        An option names a wiring that is impossible, or the answers end.
    InstrumentError, AnalysisError, BusyError, RigError
        A strike of the options fails.
    """
    asks = not flags.transducers
    instruments.read_shared_values(flags, asks=asks)
    if asks:
        _ask_for_transducers(dialogue, instruments)
    for position, text in flags.transducers.items():
        try:
            instruments.wire(position, text)
        except ValueError as error:
            raise UsageError(f"--transducer {position}={text}: {error}") from error
    if not asks:
        instruments.check()
    if flags.strike:
        instruments.strike_each(flags.transducers)
    if asks or flags.strike:
        instruments.propose_from_strikes(asks=asks)


def _ask_for_transducers(dialogue: Dialogue, instruments: Instruments) -> None:
    """Ask for each transducer until the person ends, and strike it on request; print failed strikes.

    Raises UsageError if the answers end.
    """
    while (position := _ask_position(dialogue, instruments.wired)) is not None:
        instruments.ask_wiring(position)
        while _ask_whether_to_strike(dialogue, position):
            try:
                instruments.strike(position)
            except (InstrumentError, AnalysisError, BusyError) as error:
                dialogue.report(f"  {error}")


def make_positions_table(methods: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Build [positions] from measuring methods by position, with the labels of the paper's positions.

    Other positions have an empty label.
    """
    labels = {name: place["label"] for name, place in read_lab_config()[0]["positions"].items()}
    return {
        name: {"method": method, "label": labels.get(name, ""), "serial_number": ""}
        for name, method in sorted(methods.items())
    }


def _ask_position(dialogue: Dialogue, taken: Mapping[str, object]) -> str | None:
    """Ask for the name of one more transducer; None if the person ends, possible after the first.

    Raises UsageError if the answers end.
    """
    text_of_question = "Position of a solitary-wave transducer" + (", - to end" if taken else "")

    def parse_position(text: str) -> str | None:
        """Parse a new position; None for "-"; raise ValueError for an invalid or used name."""
        if text == "-" and taken:
            return None
        if not text.isalnum() or text in taken:
            raise ValueError(
                f"{text!r} must be letters and digits, and not one of {', '.join(taken) or 'none'}"
            )
        return text

    return dialogue.ask("position", text_of_question, parse_position, default="-" if taken else "B")


def _ask_whether_to_strike(dialogue: Dialogue, position: str) -> bool:
    """Ask whether to strike this transducer; return False for the default answer.

    Raises UsageError if the answers end.
    """
    text, choices = f"Strike {position} once, all hands out of the rig? Or continue", ("strike", "continue")
    return dialogue.ask(f"{position}.strike", text, str, default="continue", choices=choices) == "strike"
