"""Run the paper's test on the twin as `solimon demo --exit --no-web` does: supervised and unpaced."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from daq_service.cli.run import plan_children
from daq_service.errors import BusyError, RigError, SolimonError, StorageError, UsageError
from daq_service.processes.child import log_to_file
from daq_service.processes.data_folder import prepare_data_folder, write_configuration
from daq_service.processes.supervisor import Message, Supervisor
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings

BY_SETS = {"alarms": {"decides_by": "k_of_n"}}
"""Alarm rule of the paper: sets are assessed one by one."""
VARIABILITY = "laboratory"
"""Environmental and operational variability of the test, as in the demonstration."""

_ERRORS = {kind.exit_code: kind for kind in (UsageError, RigError, StorageError, BusyError)}


def load_twin_settings(seed: int | None) -> Settings:
    """Read the shipped configuration, with `VARIABILITY` and the paper's alarm rule, not the control chart.

    Environment variables override it, and the seed unless it is None. Raises UsageError for an invalid value.
    """
    given = {} if seed is None else {"seed": seed}
    return load_settings(None, overrides={**BY_SETS, "twin": {"nuisance": VARIABILITY, **given}})


def run_twin_test(
    settings: Settings, folder: Path, *, stop: threading.Event, progress: Callable[[int, int, float], None]
) -> bool:
    """Record until the end of the schedule, or until `stop`; do not change a complete folder.

    Blocks; the recorder runs in a child process under a supervisor.

    Parameters
    ----------
    progress
        Called with sets done, sets planned and the hour.

    Returns
    -------
    bool
        True when every set is recorded, False if `stop` was set.

    Raises
    ------
    SolimonError
        The recorder ended with an error (its message is on standard error), or the folder cannot be used.
    """
    prepare_data_folder(folder)
    config = write_configuration(settings, folder)
    log_to_file(folder / "logs" / "supervisor.log")

    def on_message(child: str, message: Message) -> None:
        """Pass a progress message of the recorder to the callback; ignore other messages."""
        del child
        if message["event"] == "progress":
            progress(int(message["done"]), int(message["planned"]), float(message["due_h"]))

    supervisor = Supervisor(
        plan_children(config, folder, port=None, web=False, linger=False),
        folder,
        on_message=on_message,
        give_up=True,
    )
    code = supervisor.run(stop, stay=False)
    if stop.is_set():
        return False
    if code:
        kind = _ERRORS.get(code, SolimonError)
        raise kind(f"the test on the twin failed (exit code {code}); see {folder / 'logs'}")
    return True
