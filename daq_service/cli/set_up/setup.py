"""``solimon setup``: create a configuration for connected boards from recorded waves."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from analysis.errors import AnalysisError
from daq_service.cli.doctor.storage import read_lock_owner, refuse_if_owned
from daq_service.cli.set_up.bench import Bench
from daq_service.cli.set_up.boards import Boards
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.init import read_lab_config, refuse_to_overwrite, validate_new_file, write_config
from daq_service.cli.set_up.kinds import build_named_kinds, list_other_kinds
from daq_service.cli.set_up.other_instruments import ask_for_other_instruments
from daq_service.cli.set_up.page import Scope, serve_page
from daq_service.cli.set_up.transducers import Flags, Instruments, set_up_transducers
from daq_service.cli.set_up.wiring import describe_board
from daq_service.cli.terminal import open_page
from daq_service.errors import BusyError, RigError, UsageError
from daq_service.settings.tables import KeyPath, Tables
from hardware_drivers import errors as driver_errors

if TYPE_CHECKING:
    from hardware_drivers.daqmx.survey import Survey

LOOKED_FOR = "looked for NI-DAQmx boards with an analog trigger"
NO_BOARDS = (
    "switch the chassis on before the computer, see whether NI MAX or `nilsdev` lists the boards, and read "
    "docs/how-to/install-the-ni-driver.md; {others}; without instruments: solimon init twin FILE"
)


def run_setup(
    *,
    file: Path,
    name: str,
    transducers: Sequence[str],
    probes: Sequence[str],
    kinds: Sequence[str],
    assignments: Sequence[str],
    transport: Literal["library", "grpc"],
    grpc_address: str,
    data_dir: Path | None,
    port: int,
    no_web: bool,
    no_browser: bool,
    as_json: bool,
    supply: str,
    climate: str,
    drop_height_m: float | None,
    pulse_s: float | None,
    strike: bool,
) -> None:
    """Run `solimon setup`: find, wire and strike instruments, and write the configuration.

    Asks questions at the terminal and on a page unless transducers are given as options. Existing files are
    never overwritten; nothing is written before the end.

    Raises
    ------
    UsageError
        Options, wiring or values are invalid, the file exists, or the answers end.
    BusyError
        A recorder owns the data folder, or another program holds an instrument or the port.
    RigError
        No instrument is found, one fails, or a record cannot be assessed.
    StorageUnavailableError
        The recorder's lock file in the data folder cannot be opened.
    """
    refuse_to_overwrite(file)
    flags = Flags(
        transducers=_parse_named_options(transducers),
        probes=_parse_named_options(probes),
        supply=supply,
        climate=climate,
        drop_height_m=drop_height_m,
        pulse_s=pulse_s,
        strike=strike,
    )
    asks = not flags.transducers
    if assignments and not kinds:
        raise UsageError("--set is for --kind; NI boards are set up by questions, or by --transducer")
    dialogue = Dialogue()
    folder = data_dir or file.absolute().parent / read_lab_config()[0]["storage"]["folder"]
    refuse_if_owned("setup", read_lock_owner(folder))
    with ExitStack() as stack:
        instruments: Instruments
        scope: Scope
        if kinds:
            scope = instruments = build_named_kinds(dialogue, kinds, assignments, file, folder)
        else:
            scope = stack.enter_context(closing(find_boards(dialogue, folder, transport, grpc_address)))
            instruments = Boards(dialogue, scope)
        if asks and not no_web:
            address = stack.enter_context(serve_page(dialogue, scope, port))
            opened = ", opened in your browser" if not no_browser and open_page(address) else ""
            dialogue.report(f"scope  {address}{opened}; answer there or here")
        name = name or file.stem
        if asks:
            name = dialogue.ask("name", "Name of the test", str, default=name)
        stack.enter_context(_translate_driver_errors())
        set_up_transducers(dialogue, instruments, flags)
        probes_of = None if kinds else flags.probes
        others, off = ask_for_other_instruments(dialogue, probes_of, flags.supply, flags.climate, asks=asks)
        result = write_valid_config(dialogue, instruments, file, name, others, off)
    if as_json:
        click.echo(json.dumps(result))


@contextmanager
def _translate_driver_errors() -> Iterator[None]:
    """Convert errors of drivers and analysis in the context to BusyError or RigError of the command."""
    try:
        yield
    except driver_errors.BusyError as error:
        raise BusyError(str(error)) from error
    except (driver_errors.InstrumentError, AnalysisError) as error:
        raise RigError(str(error)) from error


def _parse_named_options(given: Sequence[str]) -> dict[str, str]:
    """Parse options ``NAME=VALUE`` to a dict; the last of equal names counts.

    Raises UsageError if the name is not letters and digits or the value is empty.
    """
    named = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not (equals and name.strip().isalnum() and value.strip()):
            raise UsageError(
                f"{text!r} is not NAME=...; name the position first, for example B=01E16086/ai0/ctr0"
            )
        named[name.strip()] = value.strip()
    return named


# What is there ---------------------------------------------------------------------------------------


def find_boards(
    dialogue: Dialogue, data_folder: Path, transport: Literal["library", "grpc"], grpc_address: str
) -> Bench:
    """Find the NI boards of this computer or of a gRPC server and print them.

    The result has all boards, since any may drive a coil.

    Parameters
    ----------
    data_folder
        Nothing strikes while a recorder owns it.

    Raises
    ------
    RigError
        No board can trigger on a wave: what was looked for, what was found, what to do.
    """
    from hardware_drivers.daqmx.survey import survey_boards

    survey = survey_boards(transport, grpc_address)
    for board in survey.boards:
        dialogue.report(f"found  {describe_board(board)}")
    usable = {board.serial: board for board in survey.boards if board.analog_trigger and board.ranges_v}
    if not usable:
        names = ", ".join(list_other_kinds()) or "none is installed, see docs/how-to/write-a-driver.md"
        others = f"instruments of other kinds: solimon setup FILE --kind NAME ({names})"
        raise RigError(
            f"{LOOKED_FOR} by {transport}: {_explain_no_boards(survey)}; {NO_BOARDS.format(others=others)}"
        )
    # Any board may drive a coil.
    boards = {board.serial: board for board in survey.boards}
    return Bench(boards=boards, data_folder=data_folder, transport=transport, grpc_address=grpc_address)


def _explain_no_boards(survey: Survey) -> str:
    """Describe why no board is usable: failed findings, boards without analog trigger, or none listed."""
    failed = [finding for finding in survey.findings if finding.state == "fail"]
    if failed:
        return "; ".join(f"{finding.subject}: {finding.detail}, {finding.remedy}" for finding in failed)
    if survey.boards:
        return f"none of {', '.join(f'{board.product} {board.serial}' for board in survey.boards)} has one"
    return f"NI-DAQmx {survey.driver_version} lists no board"


# The file --------------------------------------------------------------------------------------------


def write_valid_config(
    dialogue: Dialogue, instruments: Instruments, file: Path, name: str, others: Tables, off: set[KeyPath]
) -> dict[str, object]:
    """Validate the configuration, write it with its schema, and print the next steps.

    Returns the object for ``--json``. Raises UsageError for invalid values or a file that exists. ``others``
    and ``off`` as in `Instruments.contents`.
    """
    values, off, head = instruments.contents(others, off)
    values["name"] = name
    settings = validate_new_file(values, off, file)
    write_config(file, values, head=head, off=off)
    dialogue.report(f"{file} is written with its schema ({settings.configuration_hash()[:12]})")
    dialogue.report(f"next: solimon check-config {file}, then docs/how-to/set-up-a-rig.md")
    return {"file": str(file), "configuration_hash": settings.configuration_hash(), **instruments.result()}
