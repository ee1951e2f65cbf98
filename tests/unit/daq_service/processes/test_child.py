"""Log and signals of a child process: its log survives a full disk and a reader that locks it."""

import errno
import io
import logging
import signal
import sys
import threading

import pytest

from daq_service.processes import child
from daq_service.processes.child import LogFile, log_to_file, stop_on_signals


@pytest.fixture
def logged(tmp_path):
    """Write lines through a handler, as the root logger does."""
    handler = LogFile(tmp_path / "recorder.log")
    handler.setFormatter(logging.Formatter("%(message)s"))
    yield handler, lambda text: handler.handle(logging.makeLogRecord({"msg": text}))
    handler.close()


def lines(folder, name="recorder.log"):
    return (folder / name).read_text(encoding="utf-8").splitlines()


class FullDisk(io.StringIO):
    """Stream on a full disk."""

    def write(self, text):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_costs_lines_which_are_counted_and_no_traceback(logged, tmp_path, capsys):
    handler, write = logged
    write("before")
    stream, handler.stream = handler.stream, FullDisk()
    for number in range(3):
        write(f"lost {number}")
    handler.stream = stream
    write("after")
    assert lines(tmp_path) == ["before", "3 lines could not be written here", "after"]
    assert capsys.readouterr().err == ""


def test_a_log_that_is_open_in_a_reader_is_not_rotated_but_continued(logged, tmp_path, monkeypatch):
    """Windows does not rename an open file."""
    handler, write = logged
    handler.maxBytes = 30
    write("x" * 25)

    def held(source, target):
        raise PermissionError(errno.EACCES, "in use", source)

    with monkeypatch.context() as reading:
        reading.setattr("os.rename", held)
        for number in range(3):
            write(f"line {number} of the test")
    assert len(lines(tmp_path)) == 4
    write("a line after the reader")
    assert len(lines(tmp_path, "recorder.log.1")) == 4
    assert lines(tmp_path) == ["a line after the reader"]


def test_a_log_that_cannot_be_made_is_a_warning(tmp_path, capsys, monkeypatch):
    (tmp_path / "logs").write_text("foreign")
    root = logging.Logger("root")
    monkeypatch.setattr(logging, "getLogger", lambda name=None: root)
    log_to_file(tmp_path / "logs" / "recorder.log")
    root.warning("a line")
    assert "the test continues without it" in capsys.readouterr().err
    assert (tmp_path / "logs").read_text() == "foreign"


@pytest.fixture
def usual_signals():
    """Handle each signal as in a terminal: the runner itself may have been started by `nohup`."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGHUP, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.skipif(sys.platform == "win32", reason="no terminal hangs up there")
@pytest.mark.usefixtures("usual_signals")
def test_a_closed_terminal_is_an_orderly_stop():
    with stop_on_signals() as stop:
        assert not stop.is_set()
        signal.raise_signal(signal.SIGHUP)
        assert stop.wait(60.0)


@pytest.mark.skipif(sys.platform == "win32", reason="no program is started so there")
@pytest.mark.usefixtures("usual_signals")
@pytest.mark.parametrize("name", ["SIGHUP", "SIGINT", "SIGTERM"])
def test_a_stop_signal_that_is_ignored_at_the_start_stays_ignored(name):
    """`nohup solimon run` outlives its terminal; background jobs of a script get no Ctrl-C."""
    number = getattr(signal, name)
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with stop_on_signals() as stop:
            assert signal.getsignal(number) is signal.SIG_IGN
            signal.raise_signal(signal.SIGTERM if name == "SIGHUP" else signal.SIGHUP)
            assert stop.wait(60.0), "the others stop it as ever"
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


@pytest.mark.timeout(60)
def test_a_signal_during_a_read_of_the_event_is_handled():
    """Its handler runs in the thread that holds the lock of the event, and must not wait."""
    with stop_on_signals() as stop:
        with stop._cond:
            signal.raise_signal(signal.SIGTERM)
        assert stop.wait(60.0)
    assert "signals" not in {thread.name for thread in threading.enumerate()}


@pytest.mark.parametrize(("sent", "expected"), [(child.FAREWELL, False), (b"", True)])
def test_a_child_detects_whether_its_supervisor_left_on_purpose(sent, expected, monkeypatch):
    answers = iter([sent])
    monkeypatch.setattr(child.os, "read", lambda pipe, count: next(answers))
    monkeypatch.setattr(child.sys, "stdin", sys.__stdin__)
    stop = threading.Event()
    left_alone = child.stop_when_pipe_closes(stop)
    assert stop.wait(60.0)
    assert left_alone.is_set() == expected
