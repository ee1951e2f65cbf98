"""``hold``, ``release``, ``retire``, ``reinstate``, ``supply``: orders without a browser.

A row of ``commands`` is written and the recorder's answer awaited; the recorder alone decides. An order
that it has not begun in time expires: nobody carries it out later.
"""

from __future__ import annotations

import getpass
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.rows import CommandRow
from daq_service.commands.audit import TERMINAL, Audit
from daq_service.commands.deadline import command_state
from daq_service.commands.registry import parse_command
from daq_service.errors import EXIT_OK, BusyError, UsageError
from daq_service.processes.data_folder import refuse_other_folders, settings_and_folder
from daq_service.processes.recorder_state import PROCESS_EVENTS, read_recorder_state

START_WITHIN_S = 30.0
"""A recorder looks several times a second, but not while it waits for a record or stores a set."""
CARRIED_OUT_WITHIN_S = 120.0
"""An order that was begun is waited for: a supply that does not answer takes the time of many replies."""
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
    wait: Callable[[float], None] = time.sleep,
    **arguments: str | float | None,
) -> int:
    """Write an order, wait for its answer and print it.

    The folder's configuration is not compared with CONFIG: a hold must not fail for a wrong file.

    Parameters
    ----------
    author
        None: the name of this user.
    within_s, carried_out_within_s
        Time to begin it, after which it expires, and time from there to the answer.
    wait
        Waits a number of seconds between two looks for the answer; injected by tests.
    **arguments
        What the kind needs beside the note; None is left out.

    Raises
    ------
    BusyError
        No recorder runs there (nothing is written), the order expired, or what became of it is not known.
    UsageError
        The arguments are none of this kind, the folder is none of ours, or the recorder refused, with its
        reason.
    StorageError
        No data there yet, or the catalogue cannot be written.
    """
    author = (author or user_name())[:LONGEST_AUTHOR]
    given = {"note": note} | {name: value for name, value in arguments.items() if value is not None}
    parse_command(kind, author, given)  # refused here, no recorder need look at it
    _, folder = settings_and_folder(config, data_dir)
    refuse_other_folders(folder)
    audit = partial(
        Audit(folder).tell, who=author, role="claimed", source=TERMINAL, what=kind, arguments=given
    )
    try:
        with open_catalogue(folder) as catalogue:
            _check_somebody_listens(folder, catalogue)
            order_id = catalogue.add_command(author, kind, given, within_s=within_s)
            audit(result="accepted", command_id=order_id)
            row = _answered(catalogue, order_id, carried_out_within_s, wait)
    except BusyError as error:
        audit(result="refused", why=str(error))
        raise
    if as_json:
        names = ("id", "kind", "author", "arguments", "state", "result")
        click.echo(json.dumps({name: getattr(row, name) for name in names}))
    if row.state == "refused":
        raise UsageError(f"the recorder refused to {kind}: {row.result}")
    if row.state == "started":
        raise BusyError(
            f"the recorder began order {order_id} ({kind}) and has not answered within "
            f"{carried_out_within_s:g} s; look before you give it again: `solimon status` tells what it does"
        )
    if row.state != "done":
        raise BusyError(f"order {order_id} ({kind}) {row.state}: {row.result}")
    if not as_json:
        click.echo(row.result)
    return EXIT_OK


def _check_somebody_listens(folder: Path, catalogue: Catalogue) -> None:
    told = catalogue.last_service_event(*PROCESS_EVENTS)
    recorder = read_recorder_state(folder, [told.kind] if told else [])
    if recorder.status == "running" and not recorder.listens:
        raise BusyError(
            f"the recorder of {folder} is {recorder.description.removeprefix('running, ')}: nothing "
            "strikes, and it hears no orders before its rig is open; give the order again then, or stop it"
        )
    if not recorder.listens:
        raise BusyError(
            f"no recorder runs on {folder}: nothing strikes, and nobody would carry this out; start it with "
            "`solimon run` or `solimon record`, then give the order again"
        )


def _answered(
    catalogue: Catalogue, order_id: int, carried_out_within_s: float, wait: Callable[[float], None]
) -> CommandRow:
    """Row of the order once it is answered or has expired, or as it stands when the time is over."""
    begun_s: float | None = None
    while True:
        found = command_state(catalogue, order_id)
        assert found is not None, "it was just written"
        row, _ = found
        if row.state == "started" and begun_s is None:
            begun_s = time.monotonic()
        if row.state not in ("pending", "started"):
            return row
        if begun_s is not None and time.monotonic() >= begun_s + carried_out_within_s:
            return row
        wait(LOOK_EVERY_S)


def user_name() -> str:
    """Return the name of whoever sits at this computer, as its system knows it."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return "operator"  # a container's user may have no name
