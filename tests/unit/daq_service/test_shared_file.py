"""Files that processes share: short waits, and continuation without the file."""

import itertools
import os
from pathlib import Path

import pytest

from daq_service import shared_file
from daq_service.shared_file import (
    LONGEST_PAUSE_S,
    read_best_effort,
    read_shared,
    remove_quietly,
    retry,
    write_best_effort,
    write_durably,
)


class FailingCall:
    """Callable that fails at first, as Windows does while another process holds the file."""

    def __init__(self, call, times, error=None):
        self.call, self.left = call, times
        self.error = error or PermissionError(13, "in use by another process")

    def __call__(self, *arguments, **options):
        if self.left:
            self.left -= 1
            raise self.error
        return self.call(*arguments, **options)


def test_a_refusal_is_waited_out_in_growing_pauses():
    pauses = []
    assert retry(FailingCall(lambda: "done", 10), pause=pauses.append) == "done"
    assert len(pauses) == 10
    assert pauses == sorted(pauses)
    assert pauses[-1] == LONGEST_PAUSE_S


def test_a_permanent_refusal_is_raised():
    calls = FailingCall(lambda: "done", 10**9)
    with pytest.raises(PermissionError, match="in use"):
        retry(calls, patience_s=0.0, pause=lambda seconds: None)


@pytest.mark.parametrize("error", [FileNotFoundError(), IsADirectoryError(), OSError(28, "disk full")])
def test_other_errors_are_not_waited_for(error):
    pauses = []
    with pytest.raises(type(error)):
        retry(FailingCall(lambda: "done", 1, error), pause=pauses.append)
    assert pauses == []


@pytest.mark.parametrize("call", ["open", "replace", "unlink"])
def test_a_required_call_waits(tmp_path, monkeypatch, call):
    monkeypatch.setattr(shared_file.os, call, FailingCall(getattr(os, call), 3))
    path = tmp_path / "set.h5"
    if call == "unlink":
        path.write_bytes(b"old")
        remove_quietly(path)
        assert not path.exists()
        return
    write_durably(path, b"content", temporary=tmp_path / "set.tmp")
    assert [item.name for item in tmp_path.iterdir()] == ["set.h5"]
    assert path.read_bytes() == b"content"


def test_a_reader_waits_for_what_it_needs_and_not_for_a_hint(tmp_path, monkeypatch):
    path = tmp_path / "picture.bin"
    path.write_bytes(b"picture")
    refusing = FailingCall(Path.read_bytes, 3)
    monkeypatch.setattr(Path, "read_bytes", lambda self: refusing(self))  # noqa: PLW0108 - a method
    assert read_best_effort(path) is None
    assert read_shared(path) == b"picture"
    assert read_best_effort(tmp_path / "absent") is None
    with pytest.raises(FileNotFoundError):
        read_shared(tmp_path / "absent")


def test_an_optional_write_is_given_up_immediately_and_the_next_one_is_complete(tmp_path, monkeypatch):
    path = tmp_path / "picture.bin"
    assert write_best_effort(path, b"first") is None
    with monkeypatch.context() as held:
        held.setattr(shared_file.os, "replace", FailingCall(os.replace, 1))
        assert isinstance(write_best_effort(path, b"second"), PermissionError)
    assert path.read_bytes() == b"first"
    assert write_best_effort(path, b"third") is None
    assert [item.read_bytes() for item in tmp_path.iterdir()] == [b"third"]


@pytest.mark.parametrize("short", [None, 1, 700, 5000])
def test_buffers_are_written_to_the_last_byte_however_little_a_call_takes(tmp_path, monkeypatch, short):
    buffers = [bytes([number % 256]) * (number % 7 + 1) for number in range(1500)]
    real_write, real_writev = os.write, getattr(os, "writev", None)

    def write(descriptor, content):
        return real_write(descriptor, bytes(content)[:short])

    monkeypatch.setattr(shared_file.os, "write", write)
    if real_writev is not None:
        monkeypatch.setattr(
            shared_file.os, "writev", lambda descriptor, some: write(descriptor, b"".join(some))
        )
    descriptor = os.open(tmp_path / "file", os.O_WRONLY | os.O_CREAT)
    try:
        shared_file.write_all(descriptor, buffers)
    finally:
        os.close(descriptor)
    assert (tmp_path / "file").read_bytes() == b"".join(buffers)


@pytest.mark.parametrize(
    ("n_refusals", "options", "n_reports"), [(3, {}, 0), (9, {}, 1), (1, {"report_after_s": 0.0}, 1)]
)
def test_a_refusal_that_lasts_is_logged_once_though_a_later_try_succeeds(
    monkeypatch, caplog, n_refusals, options, n_reports
):
    seconds = itertools.count(0.0, 0.25)
    monkeypatch.setattr(shared_file.time, "monotonic", lambda: next(seconds))
    call = FailingCall(lambda: "done", n_refusals)
    assert retry(call, pause=lambda pause_s: None, **options) == "done"
    assert caplog.text.count("refused, tried again") == n_reports
