"""Set up transducers one by one: wiring, input at rest, strikes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from analysis.errors import AnalysisError
from daq_service.cli.doctor.spike import edge_in_words
from daq_service.cli.set_up.bench import Bench, rms_v
from daq_service.cli.set_up.dialogue import Dialogue, Question
from daq_service.cli.set_up.values import REMEDIES, assess_strikes
from daq_service.cli.set_up.wiring import coil_counters, home_terminal, inputs_of, wiring_of
from daq_service.errors import BusyError, UsageError
from daq_service.settings.tree import Settings
from hardware_drivers.daqmx.parameters import TransducerWiring
from hardware_drivers.errors import InstrumentError


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


def take_transducers(dialogue: Dialogue, bench: Bench, flags: Flags) -> None:
    """Wire the transducers of the flags; strike only if requested."""
    bench.drop_height_m = flags.drop_height_m or bench.drop_height_m
    bench.pulse_s = flags.pulse_s or bench.pulse_s
    for position, text in flags.transducers.items():
        try:
            _print_quiet(dialogue, position, bench, wiring_of(bench.boards, text))
        except ValueError as error:
            raise UsageError(f"--transducer {position}={text}: {error}") from error
    if flags.strike:
        for position in flags.transducers:
            bench.strike(position)
        while (proposal := bench.proposal()) is not None and proposal.again:
            for position in proposal.again:
                bench.take_range(position, proposal.range_v[position])
                bench.strike(position)
        assess_strikes(dialogue, bench, asks=False)


def _print_quiet(dialogue: Dialogue, position: str, bench: Bench, wiring: TransducerWiring) -> None:
    """Wire a transducer and print its input at rest."""
    record = bench.wire(position, wiring)
    dialogue.report(
        f"{position}      {wiring.input} of {wiring.board_serial}, coil at {wiring.counter} "
        f"({wiring.output_terminal}): at rest {record.volts().mean() * 1e3:.3g} mV, noise "
        f"{rms_v(record) * 1e3:.3g} mV rms"
    )


def ask_for_transducers(dialogue: Dialogue, bench: Bench, flags: Flags) -> None:
    """Ask for transducers until the person ends."""
    for name, text, bounds in (
        ("drop_height_m", "Height the strikers fall from, m", (0.0, 1.0)),
        ("pulse_s", "Time a coil is on, s (it lifts the striker)", (1e-3, 0.5)),
    ):
        preset = getattr(flags, name)
        value = preset or dialogue.ask(
            Question(name=name, text=text, default=f"{getattr(bench, name):g}"), _number_within(*bounds)
        )
        setattr(bench, name, value)
    while (position := ask_position(dialogue, bench.transducers)) is not None:
        _wire(dialogue, bench, position)
        while strikes_or_goes_on(dialogue, position):
            try:
                bench.strike(position)
                _print_strike(dialogue, bench, position)
            except (InstrumentError, AnalysisError, BusyError) as error:
                dialogue.report(f"  {error}")
    assess_strikes(dialogue, bench, asks=True)


def ask_position(dialogue: Dialogue, taken: Mapping[str, Any]) -> str | None:
    """Ask for one more transducer; None if there is none."""
    question = Question(
        name="position",
        text="Position of a solitary-wave transducer" + (", - for no more" if taken else ""),
        default="-" if taken else "B",
    )
    return dialogue.ask(question, lambda text: _new_position(text, taken))


def strikes_or_goes_on(dialogue: Dialogue, position: str) -> bool:
    """Ask whether to strike; the default is no."""
    question = Question(
        name=f"{position}.strike",
        text=f"Strike {position} once, nobody's hands inside? Or go on",
        default="go on",
        choices=("strike", "go on"),
    )
    return dialogue.ask(question, lambda answer: answer == "strike")


def _number_within(low: float, high: float) -> Callable[[str], float]:
    def parse(text: str) -> float:
        value = float(text)
        if not low < value <= high:
            raise ValueError(f"{value:g} is not within {low:g} .. {high:g}")
        return value

    return parse


def _new_position(text: str, taken: Mapping[str, Any]) -> str | None:
    """Return a valid new position; None for the end."""
    if text == "-" and taken:
        return None
    if not text.isalnum() or text in taken:
        raise ValueError(f"{text!r} must be letters and digits, and not one of {', '.join(taken) or 'none'}")
    return text


def report_file(dialogue: Dialogue, file: Path, settings: Settings) -> None:
    """Report the written file and the next steps."""
    dialogue.report(f"{file} is written, its schema beside it ({settings.configuration_hash()[:12]})")
    dialogue.report(f"next: solimon check-config {file}, then docs/how-to/day-one.md")


def _wire(dialogue: Dialogue, bench: Bench, position: str) -> None:
    """Ask for the wiring of a transducer until its input can be read."""
    taken = {(one.board_serial, one.input) for one in bench.transducers.values()}
    taken |= {(one.coil_serial, one.counter) for one in bench.transducers.values()}
    while True:
        recording = [serial for serial, board in bench.boards.items() if board.analog_trigger]
        serial = _choice(dialogue, f"{position}.board", f"Board that records {position}", recording)
        inputs = [name for name in inputs_of(bench.boards[serial]) if (serial, name) not in taken]
        channel = _choice(dialogue, f"{position}.input", f"Input of the PZT of {position}", inputs)
        # The digitizer's own counters first: they can hold the trigger off.
        serials = sorted(bench.boards, key=lambda one: one != serial)
        counters = [
            name if one == serial else f"{one}/{name}"
            for one in serials
            for name in coil_counters(bench.boards[one])
            if (one, name) not in taken
        ]
        counter = _choice(dialogue, f"{position}.counter", f"Counter of the coil of {position}", counters)
        coil_board = bench.boards[counter.rpartition("/")[0] or serial]
        terminal = dialogue.ask(
            Question(
                name=f"{position}.terminal",
                text="Terminal its pulse leaves the board at",
                default=home_terminal(coil_board, counter.rpartition("/")[2]),
            ),
            str,
        )
        try:
            wiring = wiring_of(bench.boards, f"{serial}/{channel}/{counter}/{terminal}")
            _print_quiet(dialogue, position, bench, wiring)
        except (ValueError, InstrumentError) as error:
            dialogue.report(f"  {error}")
        else:
            return


def _choice(dialogue: Dialogue, name: str, text: str, choices: Sequence[str]) -> str:
    """Ask for one of the choices."""
    if not choices:
        raise UsageError(f"{text}: nothing is left to choose; add a board, or end with fewer positions")
    return dialogue.ask(Question(name=name, text=text, default=choices[0], choices=choices), str)


def _print_strike(dialogue: Dialogue, bench: Bench, position: str) -> None:
    """Print the survey of the newest strike and its remedies."""
    proposal = bench.proposal()
    assert proposal is not None, "it was struck"
    survey = proposal.surveys[position]
    wave = "no wave stands out"
    if survey.wave_v is not None and survey.wave_after_s is not None:
        wave = f"wave of {survey.wave_v:.3g} V {survey.wave_after_s * 1e3:.3g} ms after off"
    dialogue.report(
        f"{position}      on: {edge_in_words(survey.on)}; off: {edge_in_words(survey.off)}; {wave}"
    )
    if position in proposal.troubles:
        dialogue.report(f"{position}      {REMEDIES[proposal.troubles[position]]}")
    if position in proposal.again:
        bench.take_range(position, proposal.range_v[position])
        dialogue.report(f"{position}      clipped; strike again, now in +-{proposal.range_v[position]:g} V")
