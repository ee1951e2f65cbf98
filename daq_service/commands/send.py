"""Send a command to the recorder from the command line, such as ``pause`` or ``supply``.

It writes a row of ``commands`` and waits for the recorder's answer; only the recorder decides. A command that
is not started in time expires and is not executed later.
"""

from __future__ import annotations

import getpass
import json
from functools import partial
from pathlib import Path

import click

from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.rows import CommandRow
from daq_service.clock import MACHINE, MachineClock
from daq_service.commands.audit import TERMINAL, Audit
from daq_service.commands.deadline import read_command_state
from daq_service.commands.registry import parse_command
from daq_service.errors import EXIT_OK, BusyError, UsageError
from daq_service.processes.data_folder import load_settings_and_folder, require_data_folder
from daq_service.processes.recorder_state import PROCESS_EVENTS, read_recorder_state

START_WITHIN_S = 30.0
"""A recorder reads commands several times per second, but not while it waits for a record or stores a set."""
CARRIED_OUT_WITHIN_S = 120.0
"""Time to wait for a started command: a supply that does not respond takes the time of many replies."""
LOOK_EVERY_S = 0.1
LONGEST_AUTHOR = 80


def send_command(
    kind: str,
    *,
    config: Path | None,
    data_dir: Path | None,
    note: str,
    author: str | None,
    as_json: bool,
    within_s: float = START_WITHIN_S,
    carried_out_within_s: float = CARRIED_OUT_WITHIN_S,
    machine: MachineClock = MACHINE,
    **arguments: str | float | None,
) -> int:
    """Send a command, wait for its answer and print it; return the exit code 0 if it was executed.

    The folder's configuration is not compared with CONFIG: a pause must not fail for a wrong file. The
    request is written to the audit log.

    Parameters
    ----------
    author
        None: the name of this user. At most `LONGEST_AUTHOR` characters are used.
    within_s, carried_out_within_s
        Time to start it, after which it expires, and time from the start to the answer.
    **arguments
        Further arguments of the kind; None is left out.

    Raises
    ------
    BusyError
        No recorder runs there (nothing is sent), the command expired, or its result is unknown.
    UsageError
        The arguments are not valid for this kind, the folder is no data folder, or the recorder rejected
        the command, with its reason.
    StorageError
        No data there yet, or the catalogue cannot be written.
    """
    author = (author or get_user_name())[:LONGEST_AUTHOR]
    all_arguments = {"note": note} | {name: value for name, value in arguments.items() if value is not None}
    parse_command(kind, author, all_arguments)  # refused here, no recorder need look at it
    _, folder = load_settings_and_folder(config, data_dir)
    require_data_folder(folder)
    audit = partial(
        Audit(folder).add, author=author, role="claimed", source=TERMINAL, what=kind, arguments=all_arguments
    )
    try:
        with open_catalogue(folder) as catalogue:
            _require_listening_recorder(folder, catalogue)
            order_id = catalogue.add_command(author, kind, all_arguments, within_s=within_s)
            audit(result="accepted", command_id=order_id)
            row = _wait_for_answer(catalogue, order_id, carried_out_within_s, machine)
    except BusyError as error:
        audit(result="rejected", reason=str(error))
        raise
    if as_json:
        names = ("id", "kind", "author", "arguments", "state", "result")
        click.echo(json.dumps({name: getattr(row, name) for name in names}))
    if row.state == "rejected":
        raise UsageError(f"the recorder rejected {kind}: {row.result}")
    if row.state == "started":
        raise BusyError(
            f"the recorder started command {order_id} ({kind}) and has not answered within "
            f"{carried_out_within_s:g} s; before you send it again, check it with `solimon status`"
        )
    if row.state != "done":
        raise BusyError(f"command {order_id} ({kind}) {row.state}: {row.result}")
    if not as_json:
        click.echo(row.result)
    return EXIT_OK


def _require_listening_recorder(folder: Path, catalogue: Catalogue) -> None:
    """Raise BusyError unless a recorder of the folder runs and accepts commands.

    The message states whether no recorder runs, or its rig is not open yet.
    """
    event = catalogue.read_last_service_event(*PROCESS_EVENTS)
    recorder = read_recorder_state(folder, [event.kind] if event else [])
    if recorder.status == "running" and not recorder.listens:
        raise BusyError(
            f"the recorder of {folder} is {recorder.description.removeprefix('running, ')}: nothing strikes, "
            "and it accepts no commands before its rig is open; send the command again then, or stop it"
        )
    if not recorder.listens:
        raise BusyError(
            f"no recorder runs on {folder}: nothing would execute this command; start one with "
            "`solimon run` or `solimon record`, then send the command again"
        )


def _wait_for_answer(
    catalogue: Catalogue, order_id: int, carried_out_within_s: float, machine: MachineClock
) -> CommandRow:
    """Poll a command every `LOOK_EVERY_S` until it is answered or has expired, and return its row.

    A row whose state is still ``started`` is returned ``carried_out_within_s`` after its start was seen. A
    pending command is waited for until its deadline. Errors of the catalogue pass through.
    """
    started_s: float | None = None
    while True:
        command = read_command_state(catalogue, order_id)
        assert command is not None, "it was just written"
        row, _ = command
        if row.state == "started" and started_s is None:
            started_s = machine.mono_s()
        if row.state not in ("pending", "started"):
            return row
        if started_s is not None and machine.mono_s() >= started_s + carried_out_within_s:
            return row
        machine.sleep(LOOK_EVERY_S)


def get_user_name() -> str:
    """Return the user name of the operating system; ``operator`` if it has none."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "operator"  # a container's user may have no name
