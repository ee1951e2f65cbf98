"""``solimon rebuild``: needs the folder alone; no recorder may run on it."""

from __future__ import annotations

import logging
from dataclasses import asdict
from pathlib import Path

from daq_service.cli.terminal import print_set_progress
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder
from daq_service.processes.printing import print_result


def rebuild_and_print(*, data_dir: Path, as_json: bool) -> None:
    """Run `solimon rebuild`: rebuild the catalogue from the sets and print the result.

    Progress goes to standard error; the old catalogue is kept in the folder.

    Raises
    ------
    BusyError
        A recorder owns the folder.
    CatalogueError, NoDataYetError
        It cannot be rebuilt, or no test has started.
    StorageError
        The folder is missing or cannot be written.
    """
    from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue

    folder = data_dir.absolute()
    prepare_data_folder(folder, may_create=False)
    # Old alarms are raised again, which is of no interest here.
    logging.getLogger("daq_service.recording.set_assessor").addHandler(logging.NullHandler())

    with hold_recorder_lock(folder):
        built = rebuild_folder_catalogue(folder, progress=print_set_progress)
    lines = [
        f"{built.experiment}: {built.sets} sets, {built.events} events, {built.orders} orders",
        *(f"warning: {warning}" for warning in built.warnings),
        f"the old catalogue is kept as {built.kept}" if built.kept else "there was no catalogue before",
    ]
    print_result(asdict(built), lines, as_json=as_json)
