"""Foreign texts at a terminal, in a log and in a spreadsheet."""

import csv
import io
import logging
import sys
from types import SimpleNamespace

import click
import numpy as np
import pytest

from daq_service.cli.main import main
from daq_service.cli.reproduce.item import Table
from daq_service.cli.reproduce.output import format_csv
from daq_service.cli.sweep.outputs import format_csv as format_sweep
from daq_service.cli.sweep.table import SweepTable
from daq_service.cli.terminal import ProgressReport
from daq_service.processes.child import log_to_file
from daq_service.settings.foreign_text import escape_output
from daq_service.web.tables.formats import FORMATS

EVIL = "a\x1b[2J\x07\x9b1m\u202e\r\nFORGED"
FORMULAS = [*"=+-@\uff1d\uff0b\uff0d\uff20", "  =", "\t=", "\n="]


def test_no_log_line_can_be_forged(tmp_path, monkeypatch):
    monkeypatch.setattr("faulthandler.enable", lambda file: file.close())
    root = logging.getLogger()
    before = list(root.handlers), root.level
    try:
        log_to_file(tmp_path / "logs" / "web.log")
        try:
            raise ValueError(EVIL)
        except ValueError:
            logging.getLogger("test").exception("held by %s", EVIL)
    finally:
        for handler in set(root.handlers) - set(before[0]):
            handler.close()
            root.removeHandler(handler)
        root.setLevel(before[1])
    lines = (tmp_path / "logs" / "web.log").read_text(encoding="utf-8").splitlines()
    assert "held by a\\x1b[2J\\x07\\x9b1m\\u202e\\r\\nFORGED" in lines[0]
    assert not [line for line in lines[1:] if line and not line.startswith("  ")]
    assert not any(set("\x1b\x07\x9b\u202e") & set(line) for line in lines)


def test_no_control_character_reaches_a_terminal(capsys, monkeypatch):
    with escape_output():
        print(EVIL)
        print(EVIL, file=sys.stderr)
        click.echo("\rset 3 of 4", err=True)
    printed = capsys.readouterr()
    assert printed.out == "a\\x1b[2J\\x07\\x9b1m\\u202e\\r\nFORGED\n"
    assert printed.err == f"{printed.out}\rset 3 of 4\n"
    monkeypatch.setattr(sys, "argv", ["solimon", "features", f"{EVIL}.npy"])
    with pytest.raises(SystemExit):
        main()
    printed = capsys.readouterr()
    assert "\\x07" in printed.err
    assert "\x1b" not in printed.out + printed.err


def test_an_event_of_a_running_test_is_one_line(capsys):
    with ProgressReport() as reporting:
        reporting("alarm", change="alarm_raised", hour=1.0, priority="critical", message=EVIL)
        reporting("waits", reason=EVIL)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert not any("\x1b" in line for line in lines)


@pytest.mark.parametrize("text", FORMULAS, ids=ascii)
def test_no_spreadsheet_executes_a_text(text):
    text += "1+1"
    columns = [SimpleNamespace(name=name) for name in ("text", "number", "whole")]
    page = {"text": [text, "a=1", None], "number": [-1.5, 2.0, None], "whole": [-3, 4, None]}
    exported = b"".join(FORMATS["csv"].write(SimpleNamespace(columns=columns), {}, [page])).decode()
    swept = format_sweep(
        SweepTable(
            swept={"text": [text]}, results={"number": np.array([-1.5])}, status=["ok"], forces=None, facts={}
        )
    )
    reproduced = format_csv(Table(columns={"text": [text], "number": [-1.5]})).decode()
    assert list(csv.reader(io.StringIO(exported, newline="")))[1:] == [
        [f"'{text}", "-1.5", "-3"],
        ["a=1", "2.0", "4"],
        ["", "", ""],
    ]
    for content in (swept, reproduced):
        assert list(csv.reader(io.StringIO(content, newline="")))[1][:2] == [f"'{text}", "-1.5"]
