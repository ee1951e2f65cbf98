"""Every end of a command is a code of the table and one line."""

import pytest
from support.command_line import solimon_here

from daq_service.archive import ArchiveWriteError
from daq_service.catalogue.errors import CatalogueBusyError, CatalogueWriteError
from daq_service.cli import inspection, run
from daq_service.processes.supervisor import FINAL_CODES


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (KeyError("thickness_m"), 1, "KeyError: 'thickness_m'"),
        (OSError(24, "Too many open files"), 1, "Too many open files"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_nobody_foresaw_is_one_line_with_its_place(monkeypatch, tmp_path, raised, code, words):
    def fail(folder, settings):
        raise raised

    monkeypatch.setattr(inspection, "describe_status", fail)
    done = solimon_here("status", "--data-dir", str(tmp_path), env={})
    (line,) = filter(None, done.stderr.splitlines())  # click moves on to a new line first
    assert (done.returncode, done.stdout) == (code, "")
    assert line.startswith("solimon: ")
    assert words in line
    assert ("inspection.py, line " in line or "test_main.py, line " in line) == (code == 1)


@pytest.mark.parametrize("command", ["record", "serve"])
@pytest.mark.parametrize(
    "error",
    [CatalogueBusyError("locked"), CatalogueWriteError("full"), ArchiveWriteError("read-only")],
    ids=str,
)
def test_a_disk_that_refuses_ends_a_start_by_hand_and_has_one_by_the_supervisor_tried_again(
    monkeypatch, tmp_path, error, command
):
    def fail(*_args, **_options):
        raise error

    monkeypatch.setattr(run, "prepare_data_folder", fail)
    by_hand = solimon_here(command, "--data-dir", str(tmp_path), env={})
    again = solimon_here(command, "--data-dir", str(tmp_path), "--restarted-because", "crashed", env={})
    assert (by_hand.returncode, again.returncode) == (4, 1)
    assert again.returncode not in FINAL_CODES
    assert str(error) in by_hand.stderr
    assert str(error) in again.stderr
