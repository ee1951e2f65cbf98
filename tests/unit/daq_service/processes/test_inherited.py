"""Inherited signals, timers and terminals do not affect a process; each test uses a real process."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.waiting import WAIT_S

from daq_service.processes.child import PROGRAM
from daq_service.processes.supervisor import start_process

if sys.platform == "win32":
    pytest.skip("nothing of this is inherited there", allow_module_level=True)

import resource

START = """
import os, signal, sys, time
from daq_service.processes.inherited import reset_inherited_settings
reset_inherited_settings()
from daq_service.processes.printing import force_exit_if_needed, print_line
"""


def run_python(script, inherit=lambda: None, **streams):
    return subprocess.run(
        [sys.executable, "-c", START + script],
        preexec_fn=inherit,
        # Otherwise Python has no buffer to flush at its end.
        env={name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"},
        text=True,
        timeout=WAIT_S,
        check=False,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams},
    )


def close_streams():
    for descriptor in (0, 1, 2):
        os.close(descriptor)


def test_a_closed_stream_gives_its_number_to_no_file(tmp_path):
    done = run_python(
        f"file = open({str(tmp_path / 'set.h5')!r}, 'w')\n"
        "assert file.fileno() > 2\n"
        "print('no data'); print_line('no data'); os.write(2, b'of a library')\n"
        "assert sys.stdin.read() == ''\n"
        f"print(os.system('echo fine >&2'), file=file)",
        close_streams,
    )
    assert done.returncode == 0
    assert (tmp_path / "set.h5").read_text() == "0\n", "a program that it starts has its streams, too"


def test_the_exit_code_of_a_child_is_read_even_if_the_parent_ignores_its_signal():
    done = run_python(
        "import subprocess\nchild = subprocess.run([sys.executable, '-c', 'raise SystemExit(7)'])\n"
        "sys.exit(child.returncode)",
        lambda: signal.signal(signal.SIGCHLD, signal.SIG_IGN),
    )
    assert done.returncode == 7


def test_a_stop_signal_that_is_blocked_at_the_start_is_handled():
    done = run_python(
        "os.kill(os.getpid(), signal.SIGTERM)\ntime.sleep(60)",
        lambda: signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM]),
    )
    assert done.returncode == -signal.SIGTERM


@pytest.mark.parametrize("timer", ["ITIMER_REAL", "ITIMER_VIRTUAL", "ITIMER_PROF"])
def test_a_timer_inherited_from_the_parent_is_cancelled(timer):
    """Timers such as `alarm` survive the start of another program and would end it."""
    number = getattr(signal, timer)
    done = run_python(f"print(signal.getitimer(signal.{timer})[0])", lambda: signal.setitimer(number, 3600.0))
    assert done.stdout == "0.0\n"


def test_soft_limits_are_raised_to_the_hard_ones():
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 100_000))
        resource.setrlimit(resource.RLIMIT_CPU, (60, 3600))

    done = run_python(
        "import resource\nprint(resource.getrlimit(resource.RLIMIT_FSIZE), "
        "resource.getrlimit(resource.RLIMIT_CPU))",
        limit,
    )
    assert done.stdout == "(100000, 100000) (3600, 3600)\n"


def test_a_background_process_that_prints_is_not_stopped():
    """After `stty tostop` SIGTTOU would stop the process."""
    done = run_python("print(signal.getsignal(signal.SIGTTOU).name)")
    assert done.stdout == "SIG_IGN\n"


@pytest.mark.parametrize(
    ("mask", "expected"), [(0o777, 0o600), (0o000, 0o664), (0o002, 0o664), (0o022, 0o644)]
)
def test_files_are_readable_by_their_owner_and_not_writable_by_others(mask, expected, tmp_path):
    path = tmp_path / "set.h5"
    assert run_python(f"open({str(path)!r}, 'w').close()", lambda: os.umask(mask)).returncode == 0
    assert path.stat().st_mode & 0o777 == expected


def test_letters_that_an_encoding_lacks_are_printed_as_escapes(monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    done = run_python(r"print_line('D\u00b2 9.1', err=False); print('\u2013')")
    assert (done.returncode, done.stdout) == (0, "D\\xb2 9.1\n\\u2013\n")


def test_a_folder_that_is_gone_keeps_no_worker_from_its_start(tmp_path):
    def leave():
        missing_folder = tmp_path / "gone"
        missing_folder.mkdir()
        os.chdir(missing_folder)
        missing_folder.rmdir()

    done = run_python("print(os.getcwd())", leave)
    assert (done.returncode, done.stdout) == (0, "/\n")


def test_a_file_of_the_present_folder_replaces_no_module_of_a_child(tmp_path, monkeypatch):
    for name in ("inspect", "json", "logging"):  # some may be imported before the path is searched
        (tmp_path / f"{name}.py").write_text("raise SystemExit(3)", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    process = start_process([*PROGRAM, "run", "--help"], {})
    output, _ = process.communicate()
    assert (process.returncode, output[:6]) == (0, b"Usage:")


@pytest.mark.parametrize("code", [0, 3])
def test_a_full_disk_below_the_streams_changes_no_exit_code(code):
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = run_python(
            "print_line('a line'); print_line('a line', err=False); "
            f"force_exit_if_needed({code}); sys.exit({code})",
            stdout=full.fileno(),
            stderr=full.fileno(),
        )
    assert done.returncode == code


NEWS = """
from daq_service.cli.terminal import ProgressReport
with ProgressReport() as telling:
    for _ in range(3000):
        telling('waits', reason='a rig that does not answer, and a long reason ' * 3)
print_line('the last word')
force_exit_if_needed(3)
sys.exit(3)
"""


def test_a_blocked_terminal_delays_no_exit():
    """Ctrl-S, or a reader that has stopped: the pipe takes a part of the output."""
    reader, writer = os.pipe()
    try:
        assert run_python(NEWS, stderr=writer).returncode == 3
    finally:
        os.close(reader)
        os.close(writer)


def test_python_inspect_does_not_change_the_exit(monkeypatch):
    monkeypatch.setenv("PYTHONINSPECT", "1")
    done = run_python("print('out')\nforce_exit_if_needed(3)\nsys.exit(3)", stdin=subprocess.DEVNULL)
    assert (done.returncode, done.stdout, done.stderr) == (3, "out\n", "")
