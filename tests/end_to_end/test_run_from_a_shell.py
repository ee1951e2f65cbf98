"""`solimon run` with what shells leave to it: signals that are ignored, a terminal that is held."""

import os
import signal
import subprocess

import pytest
from support.waiting import WAIT_S
from test_on_a_terminal import arguments, quick

from simulator.doubles.serial.link import pseudo_terminals_missing

if missing := pseudo_terminals_missing():
    pytest.skip(missing, allow_module_level=True)

from support.pseudo_terminal import on_terminal

pytestmark = pytest.mark.slow


def sets(folder):
    return len(list((folder / "sets").iterdir()))


def test_a_test_survives_its_terminal_on_request(tmp_path):
    """As `nohup` starts it: its terminal hangs up after a Ctrl-C."""
    ignoring = ["sh", "-c", 'trap "" HUP INT; exec "$@"', "sh"]
    with subprocess.Popen(
        [*ignoring, *arguments("run", "--no-web", folder=tmp_path / "data")],
        env={**os.environ, **quick(1.0)},
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"data: ")
        os.killpg(process.pid, signal.SIGINT)
        os.killpg(process.pid, signal.SIGHUP)
        process.communicate(timeout=WAIT_S)
    assert process.returncode == 0
    assert sets(tmp_path / "data") == 2


def test_a_held_terminal_holds_neither_the_test_nor_its_end(tmp_path):
    with on_terminal(arguments("run", "--no-web", folder=tmp_path / "data"), quick(1.0)) as terminal:
        os.write(terminal._screen, b"\x13")  # Ctrl-S
        assert terminal.process.wait(WAIT_S) == 0
    assert sets(tmp_path / "data") == 2
