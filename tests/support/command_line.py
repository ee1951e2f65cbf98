"""The command line in the process of the test: what a new process would cost is an import of everything."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from unittest.mock import patch

import click
import pytest

from daq_service.cli.main import cli, main

SOLIMON = (sys.executable, "-m", "daq_service.cli")
"""The command ``solimon`` of this interpreter, for a process of its own."""


def command_of(name: str) -> click.Command:
    """Return a command of ``solimon`` with its options."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None, name
    return command


def first_match(lines: Iterable[str], pattern: str) -> re.Match[str]:
    """Return the first match in the output of a command; fail the test when the output ends without one."""
    seen = []
    for line in lines:
        seen.append(line)
        if match := re.search(pattern, line):
            return match
    pytest.fail(f"no {pattern!r} in the output: {seen}")


def solimon_here(*arguments: str, env: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run ``solimon`` in this process; return output and exit code like `subprocess.run`."""
    out, err, code = StringIO(), StringIO(), 0
    command = ["solimon", *arguments]
    with (
        patch.object(sys, "argv", command),
        patch.dict(os.environ, env),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())
