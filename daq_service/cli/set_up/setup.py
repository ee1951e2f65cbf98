"""``solimon setup``: from boards in a box to a configuration, by looking at one's own waves."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from analysis.errors import AnalysisError
from daq_service.cli.doctor.storage import owner_of
from daq_service.cli.set_up.bench import Bench
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.init import laboratory, refuse_what_is_there, settings_of, write_file
from daq_service.cli.set_up.other_instruments import ask_for_others
from daq_service.cli.set_up.page import served_page
from daq_service.cli.set_up.transducers import Flags, ask_for_transducers, take_transducers
from daq_service.cli.set_up.wiring import board_in_words
from daq_service.cli.terminal import open_page
from daq_service.errors import BusyError, RigError, UsageError
from daq_service.settings.stored import KeyPath
from hardware_drivers import errors as driver_errors

if TYPE_CHECKING:
    from hardware_drivers.daqmx.survey import Survey

HEAD = """Written by `solimon setup` for {boards}.
{struck}

solimon check-config FILE   says what it will do
solimon doctor FILE         looks at rig, folder and computer once more; then docs/how-to/day-one.md
solimon run FILE            runs it"""
LOOKED_FOR = "looked for NI-DAQmx boards with an analog trigger"
NO_BOARDS = (
    "switch the chassis on before the computer, see whether NI MAX or `nilsdev` lists the boards, and read "
    "docs/how-to/install-the-ni-driver.md; without boards: solimon init twin FILE"
)


def run_setup(
    *,
    file: Path,
    transducers: Sequence[str],
    probes: Sequence[str],
    transport: Literal["library", "grpc"],
    grpc_address: str,
    data_dir: Path | None,
    port: int,
    no_web: bool,
    no_browser: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Carry out the command."""
    refuse_what_is_there(file)
    flags = Flags(transducers=_named(transducers), probes=_named(probes), **given)
    asks = not flags.transducers
    dialogue = Dialogue()
    folder = data_dir or file.absolute().parent / laboratory()[0]["storage"]["folder"]
    if owner := owner_of(folder):
        raise BusyError(f"setup is refused: {owner}")
    bench = look_around(dialogue, folder, transport, grpc_address)
    with ExitStack() as stack:
        stack.callback(bench.close)
        if asks and not no_web:
            _show(dialogue, stack.enter_context(served_page(dialogue, bench, port)), opens=not no_browser)
        try:
            (ask_for_transducers if asks else take_transducers)(dialogue, bench, flags)
            others, off = ask_for_others(dialogue, flags.probes, flags.supply, flags.climate, asks=asks)
        except driver_errors.BusyError as error:
            raise BusyError(str(error)) from error
        except (driver_errors.InstrumentError, AnalysisError) as error:
            raise RigError(str(error)) from error
        told = write(dialogue, bench, file, others, off)
    if as_json:
        click.echo(json.dumps(told))


def _show(dialogue: Dialogue, address: str, *, opens: bool) -> None:
    opened = ", opened in your browser" if opens and open_page(address) else ""
    dialogue.tell(f"scope  {address}{opened}; answer there or here")


def _named(given: Sequence[str]) -> dict[str, str]:
    named = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not (equals and name.strip().isalnum() and value.strip()):
            raise UsageError(
                f"{text!r} is no NAME=...; name the position first, for example B=01E16086/ai0/ctr0"
            )
        named[name.strip()] = value.strip()
    return named


# What is there ---------------------------------------------------------------------------------------


def look_around(
    dialogue: Dialogue, data_folder: Path, transport: Literal["library", "grpc"], grpc_address: str
) -> Bench:
    """Find the boards and say so.

    Parameters
    ----------
    data_folder
        Nothing strikes while a recorder owns it.

    Raises
    ------
    RigError
        There is none that can trigger on a wave: what was looked for, what was met, what to do.
    """
    from hardware_drivers.daqmx.survey import boards_there

    survey = boards_there(transport, grpc_address)
    for board in survey.boards:
        dialogue.tell(f"found  {board_in_words(board)}")
    usable = {board.serial: board for board in survey.boards if board.analog_trigger and board.ranges_v}
    if not usable:
        raise RigError(f"{LOOKED_FOR} by {transport}: {_met(survey)}; {NO_BOARDS}")
    # Any board may drive a coil.
    boards = {board.serial: board for board in survey.boards}
    return Bench(boards=boards, data_folder=data_folder, transport=transport, grpc_address=grpc_address)


def _met(survey: Survey) -> str:
    failed = [finding for finding in survey.findings if finding.state == "fail"]
    if failed:
        return "; ".join(f"{finding.subject}: {finding.detail}, {finding.remedy}" for finding in failed)
    if survey.boards:
        return f"none of {', '.join(f'{board.product} {board.serial}' for board in survey.boards)} has one"
    return f"NI-DAQmx {survey.driver_version} lists no board"


# The file --------------------------------------------------------------------------------------------


def write(
    dialogue: Dialogue, bench: Bench, file: Path, others: Mapping[str, Any], off: set[KeyPath]
) -> dict[str, Any]:
    """Write the file and its schema, prove that it is good, and say what comes next."""
    values, _ = laboratory()
    labels = {name: place["label"] for name, place in values["positions"].items()}
    places = dict.fromkeys(others.get("niscope", {}).get("probes", {}), "pulse_echo")
    if clash := set(places) & set(bench.transducers):
        raise UsageError(f"position {', '.join(clash)} is a transducer and a probe; name one otherwise")
    places |= dict.fromkeys(bench.transducers, "solitary_wave")
    values["positions"] = {
        name: {"method": method, "label": labels.get(name, ""), "serial_number": ""}
        for name, method in sorted(places.items())
    }
    rig = values["rig"]
    watchdog = rig["daqmx"]["watchdog"]
    values["rig"] = {**rig, **others, "daqmx": {**bench.table(), "watchdog": watchdog}}
    off = {*off, ("rig", "daqmx", "watchdog")}
    settings = settings_of(values, off, file)
    struck = ", ".join(bench.struck) if bench.chosen else ""
    boards = {bench.boards[one.board_serial].product for one in bench.transducers.values()}
    told = (
        f"From strikes of {struck}."
        if struck
        else "Nothing was struck: range, level and holdoff are a guess."
    )
    write_file(file, values, head=HEAD.format(boards=", ".join(sorted(boards)), struck=told), off=off)
    dialogue.tell(f"{file} is written, its schema beside it ({settings.configuration_hash()[:12]})")
    dialogue.tell(f"next: solimon check-config {file}, then docs/how-to/day-one.md")
    proposal = bench.proposal()
    return {
        "file": str(file),
        "configuration_hash": settings.configuration_hash(),
        "boards": {serial: board.product for serial, board in bench.boards.items()},
        "transducers": {name: asdict(wiring) for name, wiring in bench.transducers.items()},
        "struck": list(bench.struck),
        "proposal": None
        if proposal is None
        else asdict(replace(proposal, surveys={})) | {"taken": bool(bench.chosen)},
    }
