"""Every end of a command is a code of the table and one line."""

import pytest
from support.command_line import solimon_here

from daq_service.cli import inspection


@pytest.mark.parametrize(
    ("raised", "code", "words"),
    [
        (KeyError("thickness_m"), 1, "KeyError: 'thickness_m'"),
        (OSError(24, "Too many open files"), 1, "Too many open files"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_nobody_foresaw_is_one_line_with_its_place(monkeypatch, tmp_path, raised, code, words):
    def fail(folder):
        raise raised

    monkeypatch.setattr(inspection, "describe_status", fail)
    done = solimon_here("status", "--data-dir", str(tmp_path), env={})
    (line,) = filter(None, done.stderr.splitlines())  # click moves on to a new line first
    assert (done.returncode, done.stdout) == (code, "")
    assert line.startswith("solimon: ")
    assert words in line
    assert ("inspection.py, line " in line or "test_main.py, line " in line) == (code == 1)
