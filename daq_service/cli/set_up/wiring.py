"""Parse the wiring of a transducer, and list inputs and counters of a board."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from hardware_drivers.daqmx.parameters import TransducerWiring

if TYPE_CHECKING:
    from hardware_drivers.daqmx.survey import BoardFacts


def describe_board(board: BoardFacts) -> str:
    """Describe a board in one line: product, inputs, maximum rate, symmetric ranges, counters, trigger."""
    ranges = ", ".join(
        f"{high:g}" for low, high in sorted(board.ranges_v, key=lambda ends: ends[1]) if high == -low
    )
    trigger = "" if board.analog_trigger else "; no analog trigger: it can drive a coil, not record a wave"
    return (
        f"{board.product} {board.serial} ({board.name}): {len(board.inputs)} inputs up to "
        f"{board.max_rate_hz / 1e6:.4g} MS/s, +-{ranges} V, "
        f"{len(list_coil_counters(board))} counters{trigger}"
    )


def list_coil_counters(board: BoardFacts) -> list[str]:
    """Return the names of the board's counters that can time a pulse (``ctr0`` and so on)."""
    return [name for name in (path.rpartition("/")[2] for path in board.counters) if name.startswith("ctr")]


def find_default_terminal(board: BoardFacts, counter: str) -> str:
    """Return the default output terminal of a counter: ``CtrNOut`` if the board has it, otherwise a PFI."""
    number = int(counter[3:])
    counter_output = f"Ctr{number}Out"
    return counter_output if f"/{board.name}/{counter_output}" in board.terminals else f"PFI{12 + number}"


def parse_wiring(boards: Mapping[str, BoardFacts], text: str) -> TransducerWiring:
    """Parse ``BOARD/INPUT/COUNTER[/TERMINAL]`` or ``BOARD/INPUT/COIL_BOARD/COUNTER[/TERMINAL]``.

    Serial numbers are padded to 8 digits; a missing terminal is the default one. Raises ValueError for
    another form, an unknown board, input or counter, or a board without analog trigger.
    """
    board, *ends = text.split("/")
    serial = board.upper().zfill(8)
    coil_serial = ends.pop(1).upper().zfill(8) if len(ends) > 2 and ends[2].startswith("ctr") else serial
    if len(ends) not in (2, 3):
        raise ValueError("write BOARD/INPUT/COUNTER, for example 01E16086/ai0/ctr0")
    for one in (serial, coil_serial):
        if one not in boards:
            raise ValueError(f"there is no board {one}; there are: {', '.join(boards)}")
    if not boards[serial].analog_trigger:
        raise ValueError(
            f"{boards[serial].product} {serial} has no analog trigger, which starts every record"
        )
    channel, counter = ends[:2]
    for name, known in (
        (channel, list_analog_inputs(boards[serial])),
        (counter, list_coil_counters(boards[coil_serial])),
    ):
        if name not in known:
            raise ValueError(f"there is no {name}; there are: {', '.join(known)}")
    return TransducerWiring(
        board_serial=serial,
        striker_serial="" if coil_serial == serial else coil_serial,
        input=channel,
        counter=counter,
        output_terminal=ends[2] if len(ends) == 3 else find_default_terminal(boards[coil_serial], counter),
    )


def list_analog_inputs(board: BoardFacts) -> list[str]:
    """Return the names of a board's analog inputs, such as ``ai0``."""
    return [path.rpartition("/")[2] for path in board.inputs]
