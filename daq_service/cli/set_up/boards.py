"""Set up transducers on NI boards: wiring, input at rest, survey of strikes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from daq_service.cli.doctor.spike import describe_spike
from daq_service.cli.set_up.bench import Bench, compute_noise_rms_v
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.init import format_head_comment, read_lab_config
from daq_service.cli.set_up.transducers import Contents, Flags, make_positions_table
from daq_service.cli.set_up.values import REMEDIES, propose_and_store_values
from daq_service.cli.set_up.wiring import (
    find_default_terminal,
    list_analog_inputs,
    list_coil_counters,
    parse_wiring,
)
from daq_service.errors import UsageError
from daq_service.settings.tables import KeyPath, Tables
from hardware_drivers.daqmx.parameters import TransducerWiring
from hardware_drivers.errors import InstrumentError
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE


@dataclass(frozen=True, slots=True)
class Boards:
    """NI boards as the dialogue sets them up."""

    dialogue: Dialogue
    bench: Bench

    @property
    def wired(self) -> Mapping[str, TransducerWiring]:
        """Return the wiring of the transducers by position."""
        return self.bench.transducers

    def read_shared_values(self, flags: Flags, *, asks: bool) -> None:
        """Set drop height (m) and pulse (s) from the options; ask for a missing one if ``asks``.

        Blocks until answered; raises UsageError if the answers end. A value that is not asked for keeps its
        default.
        """
        for name, text, bounds in (
            ("drop_height_m", "Height from which the strikers fall, m", (0.0, 1.0)),
            ("pulse_s", "Time a coil is on, s (it lifts the striker)", (1e-3, 0.5)),
        ):
            value = getattr(flags, name)
            if asks and not value:
                usual = f"{getattr(self.bench, name):g}"
                value = self.dialogue.ask(name, text, _make_number_parser(*bounds), default=usual)
            if value:
                setattr(self.bench, name, value)

    def wire(self, position: str, text: str) -> None:
        """Wire a transducer given as ``BOARD/INPUT/COUNTER`` and print its input at rest.

        Raises ValueError for an impossible wiring, InstrumentError if the input cannot be read.
        """
        wiring = parse_wiring(self.bench.boards, text)
        record = self.bench.wire(position, wiring)
        self.dialogue.report(
            f"{position}      {wiring.input} of {wiring.board_serial}, coil at {wiring.counter} "
            f"({wiring.output_terminal}): at rest {record.volts().mean() * 1e3:.3g} mV, noise "
            f"{compute_noise_rms_v(record) * 1e3:.3g} mV rms"
        )

    def ask_wiring(self, position: str) -> None:
        """Ask for board, input, counter and terminal of a transducer until its input can be read.

        Raises UsageError if no board, input or counter is left, or the answers end.
        """
        boards, transducers = self.bench.boards, self.bench.transducers.values()
        taken = {(one.board_serial, one.input) for one in transducers}
        taken |= {(one.coil_serial, one.counter) for one in transducers}
        while True:
            recording = [serial for serial, board in boards.items() if board.analog_trigger]
            serial = self._ask_choice(f"{position}.board", f"Board that records {position}", recording)
            inputs = [name for name in list_analog_inputs(boards[serial]) if (serial, name) not in taken]
            channel = self._ask_choice(f"{position}.input", f"Input of the PZT of {position}", inputs)
            # The digitizer's own counters first: they can hold the trigger off.
            counters = [
                name if one == serial else f"{one}/{name}"
                for one in sorted(boards, key=lambda one: one != serial)
                for name in list_coil_counters(boards[one])
                if (one, name) not in taken
            ]
            counter = self._ask_choice(f"{position}.counter", f"Counter of the coil of {position}", counters)
            coil_board = boards[counter.rpartition("/")[0] or serial]
            home = find_default_terminal(coil_board, counter.rpartition("/")[2])
            text = "Terminal at which its pulse leaves the board"
            terminal = self.dialogue.ask(f"{position}.terminal", text, str, default=home)
            try:
                self.wire(position, f"{serial}/{channel}/{counter}/{terminal}")
            except (ValueError, InstrumentError) as error:
                self.dialogue.report(f"  {error}")
            else:
                return

    def check(self) -> None:
        """Do nothing, since each input is read when it is wired."""

    def strike(self, position: str) -> None:
        """Strike once; print the survey of the coil's spike and its remedies.

        A clipped record selects a wider input range. Raises the errors of `Bench.strike`, and AnalysisError
        if the record cannot be assessed.
        """
        self.bench.strike(position)
        proposal = self.bench.propose_values()
        assert proposal is not None, "it was struck"
        survey = proposal.surveys[position]
        wave = "no wave is above the noise"
        if survey.wave_v is not None and survey.wave_after_s is not None:
            wave = f"wave of {survey.wave_v:.3g} V {survey.wave_after_s * 1e3:.3g} ms after off"
        self.dialogue.report(
            f"{position}      on: {describe_spike(survey.on)}; off: {describe_spike(survey.off)}; {wave}"
        )
        if position in proposal.troubles:
            self.dialogue.report(f"{position}      {REMEDIES[proposal.troubles[position]]}")
        if position in proposal.again:
            range_v = proposal.range_v[position]
            self.bench.change_range(position, range_v)
            self.dialogue.report(f"{position}      clipped; strike again, now in +-{range_v:g} V")

    def strike_each(self, positions: Collection[str]) -> None:
        """Strike each transducer once, and again in a wider range while a waveform is clipped.

        Raises the errors of `Bench.strike`, and RecordError if a record cannot be assessed.
        """
        for position in positions:
            self.bench.strike(position)
        while (proposal := self.bench.propose_values()) is not None and proposal.again:
            for position in proposal.again:
                self.bench.change_range(position, proposal.range_v[position])
                self.bench.strike(position)

    def propose_from_strikes(self, *, asks: bool) -> None:
        """Propose values of the configuration from the strikes, and ask to accept them if ``asks``.

        Raises as `propose_and_store_values`.
        """
        propose_and_store_values(self.dialogue, self.bench, asks=asks)

    def contents(self, others: Tables, off: set[KeyPath]) -> Contents:
        """Return the values, the switched-off tables and the head comment of the configuration file.

        ``others`` and ``off`` as in `Instruments.contents`; the watchdog is switched off, too. Raises
        UsageError if a position is both a transducer and a probe.
        """
        values, _ = read_lab_config()
        methods = dict.fromkeys(others.get("niscope", {}).get("probes", {}), PULSE_ECHO)
        if clash := set(methods) & set(self.wired):
            raise UsageError(f"position {', '.join(clash)} is a transducer and a probe; rename one of them")
        values["positions"] = make_positions_table(methods | dict.fromkeys(self.wired, SOLITARY_WAVE))
        watchdog = values["rig"]["daqmx"]["watchdog"]
        values["rig"] |= {**others, "daqmx": {**self.bench.table(), "watchdog": watchdog}}
        boards = {self.bench.boards[one.board_serial].product for one in self.wired.values()}
        head = format_head_comment(boards, self.bench.struck if self.bench.chosen else ())
        return values, {*off, ("rig", "daqmx", "watchdog")}, head

    def result(self) -> Mapping[str, object]:
        """Return the boards, their wiring and the proposal as an object for ``--json``.

        The proposal is None before the first strike. Raises RecordError as `Bench.propose_values`.
        """
        proposal = self.bench.propose_values()
        return {
            "boards": {serial: board.product for serial, board in self.bench.boards.items()},
            "transducers": {name: asdict(wiring) for name, wiring in self.wired.items()},
            "struck": list(self.bench.struck),
            "proposal": None
            if proposal is None
            else asdict(replace(proposal, surveys={})) | {"taken": bool(self.bench.chosen)},
        }

    def _ask_choice(self, name: str, text: str, choices: Sequence[str]) -> str:
        """Ask for one of several choices, the first by default, and return it.

        Raises UsageError if there are none, or if the answers end.
        """
        if not choices:
            raise UsageError(f"{text}: nothing is left to choose; add a board, or end with fewer positions")
        return self.dialogue.ask(name, text, str, default=choices[0], choices=choices)


def _make_number_parser(low: float, high: float) -> Callable[[str], float]:
    """Create a parser of numbers above ``low`` and up to ``high``; it raises ValueError outside."""

    def parse_number(text: str) -> float:
        """Parse a number; raise ValueError for other text or outside the bounds."""
        value = float(text)
        if not low < value <= high:
            raise ValueError(f"{value:g} is not within {low:g} .. {high:g}")
        return value

    return parse_number
