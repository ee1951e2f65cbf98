"""Complete commands on a pseudo-terminal, compared with the screens in `terminal/`."""

import json
import os
import re
import runpy
import shutil
import signal
import socket
import urllib.request
from pathlib import Path

import pytest
from support.command_line import SOLIMON
from support.waiting import WAIT_S, until

from daq_service.archive import FolderSetReader
from daq_service.processes.data_folder import LOCK_FILE, read_lock_owner
from simulator.doubles.serial.link import find_missing_terminal_reason

if missing := find_missing_terminal_reason():
    pytest.skip(missing, allow_module_level=True)

from support.pseudo_terminal import on_terminal

PICTURES = Path(__file__).with_name("terminal")
FIRST_MINUTE = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "first_minute.py"))
# A coarse mesh and half of the strikes: what is shown counts.
QUICK = {
    "SOLIMON_PLATE__ELEMENTS_PER_EDGE": "16",
    "SOLIMON_SCHEDULE__SHOTS_PER_SET": "5",
    "SOLIMON_BASELINE__MINIMUM_VALID_SHOTS": "4",
    "SOLIMON_ALARMS__HOLE_SHOTS": "4",
    # However full this machine's volume is.
    "SOLIMON_STORAGE__WARN_FREE_FRACTION": "0",
    "SOLIMON_STORAGE__ALARM_FREE_FRACTION": "0",
    "SOLIMON_STORAGE__STOP_FREE_FRACTION": "0",
}
MASKS = (
    (r"http://127\.0\.0\.1:\d+/", "<address>"),
    (r"\d+ (s|min) ago", "<time> ago"),
    (r"done in \d+\.\d s", "done in <time>"),
    (r"(seconds of the recorder's last run:).*", r"\1 <cost>"),
    (r"\d+\.\d\d GB free", "<size> free"),
    # How long they take is the machine's; they are reported only where it is long.
    (r"(?m)^preparing the twin's .*: took .*\n", ""),
)


def masked(text, folder):
    text = text.replace(str(folder), "<folder>")
    for pattern, word in MASKS:
        text = re.sub(pattern, word, text)
    return text


def check(name, terminal, folder, *, at_any_time="\0"):
    """Compare the screen with the stored output; `SOLIMON_TEST_PICTURES=keep` stores the new one.

    A line that begins with ``at_any_time`` comes from another process than the others: it is put first.
    """
    lines = sorted(terminal.shown(), key=lambda line: not line.startswith(at_any_time))
    seen = masked("\n".join(lines).strip() + "\n", folder)
    picture = PICTURES / f"{name}.txt"
    if os.environ.get("SOLIMON_TEST_PICTURES") == "keep":
        picture.write_text(seen, encoding="utf-8")
    assert seen == picture.read_text(encoding="utf-8")


def arguments(*words, folder):
    return [*SOLIMON, *words, "--data-dir", str(folder)]


def quick(end_h):
    return {**QUICK, "SOLIMON_SCHEDULE__END_H": str(end_h)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("terminal") / "data"


@pytest.fixture(scope="module")
def recorded(folder):
    """Record one set by `record`."""
    with on_terminal(arguments("record", folder=folder), quick(0.5)) as terminal:
        assert terminal.end() == 0
        yield terminal


@pytest.fixture(scope="module")
def ran(folder, recorded):
    """Run another set by `run` in the same folder, then kill its recorder."""
    del recorded
    config = folder.parent / "test.toml"
    config.write_text(f"[storage]\nfolder = '{folder.name}'\n", encoding="utf-8")
    with on_terminal([*SOLIMON, "run", str(config), "--port", "0"], quick(1.0)) as terminal:
        terminal.until("the schedule is done")
        terminal.until(r"http://\S+/")
        url = re.findall(r"http://\S+/", terminal.written)[0]
        with urllib.request.urlopen(f"{url}api/v1/health", timeout=WAIT_S) as answer:
            assert json.load(answer)["as_of"]["recorder"] == "finished"
        os.kill(int(read_lock_owner(folder, LOCK_FILE).removeprefix("process ")), signal.SIGKILL)
        terminal.until("the schedule is done", times=2)
        terminal.process.send_signal(signal.SIGTERM)
        assert terminal.end() == 130
        yield terminal


def test_record_prints_its_progress_and_keeps_the_last_line(recorded, folder):
    check("record", recorded, folder)
    # Which of its first steps are seen is a matter of time.
    assert re.search("opening the rig|preparing the twin|waiting for set 0", recorded.written)
    assert "\x1b[2K" in recorded.written, "one line, written again"


def test_run_prints_the_address_the_progress_a_restart_and_the_end(ran, folder):
    check("run", ran, folder, at_any_time="dashboard")
    assert len(FolderSetReader(folder).sets()) == 2, "the folder of the configuration, beside its file"


def test_serve_prints_its_address_and_ends_by_ctrl_c(ran, folder):
    del ran
    with on_terminal(arguments("serve", "--port", "0", folder=folder), QUICK) as terminal:
        terminal.until("http://")
        assert terminal.interrupt() == 130
    check("serve", terminal, folder)


def test_a_watched_status_shows_changes_and_keeps_the_last_output(ran, folder, tmp_path):
    del ran
    watched = tmp_path / "watched"
    watched.mkdir()
    with on_terminal(arguments("status", "--watch", folder=watched), quick(1.5)) as terminal:
        terminal.until("no data yet")
        shutil.copytree(folder, watched, dirs_exist_ok=True)
        terminal.until("next +set 2, due at hour 1.5")
        shutil.rmtree(watched)
        terminal.until("cannot be read now")
        shutil.copytree(folder, watched)
        seen = len(re.findall("next +set", terminal.written))
        terminal.until("next +set", times=seen + 1)
        assert terminal.interrupt() == 130
    check("watch", terminal, watched)


def test_demo_prints_a_greeting_its_folder_the_progress_and_a_summary(tmp_path):
    folder = tmp_path / "data"
    command = arguments("demo", "--exit", "--no-web", "--hours", "0.5", folder=folder)
    with on_terminal(command, QUICK) as terminal:
        assert terminal.end() == 0
    assert terminal.written.startswith("solimon demo: ")
    check("demo", terminal, folder)


@pytest.mark.slow
@pytest.mark.parametrize("words", [("record",), ("demo", "--exit", "--no-web")], ids=["thread", "process"])
def test_the_first_compilation_is_reported_while_it_runs_and_by_one_line(tmp_path, words):
    environment = QUICK if "demo" in words else quick(0.5)
    command = arguments(*words, folder=tmp_path / "data")
    what = "preparing the twin's plates and machine code, once on this computer"
    with on_terminal(command, {**environment, "NUMBA_CACHE_DIR": str(tmp_path / "code")}) as terminal:
        terminal.until(rf"{what}: part [123] of 3, [1-9]\d* s")
        terminal.until(rf"{what}: took \d+ s")
        terminal.until(r"\d+ of \d+ sets")
        terminal.interrupt()
    lines = [line for line in terminal.shown() if "took" in line]
    assert len(lines) == 1
    assert re.fullmatch(rf"{what}: took \d+ (s|min)", lines[0])


def test_ctrl_c_after_the_end_of_a_demo_is_no_interruption(tmp_path):
    folder = tmp_path / "data"
    command = arguments("demo", "--hours", "0.5", "--port", "0", "--no-browser", folder=folder)
    with on_terminal(command, QUICK) as terminal:
        terminal.until("The test is done")
        assert terminal.interrupt() == 0
    assert f"The test is complete; its data are in {folder}." in terminal.shown()
    assert all(re.search(text, terminal.written.encode()) for text in FIRST_MINUTE["MOMENTS"].values())


@pytest.mark.parametrize("words", [("demo",), ("run",)])
def test_a_port_in_use_is_found_before_anything_else(tmp_path, words):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with on_terminal(arguments(*words, "--port", str(port), folder=tmp_path / "data"), QUICK) as terminal:
            assert terminal.end() == 5
    assert f"Port {port} is in use. Choose another with --port; 0 takes a free one." in terminal.written
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
@pytest.mark.parametrize("option", ["", "--no-browser"])
def test_demo_opens_its_page_on_a_computer_with_a_screen(tmp_path, option):
    opened, browser = tmp_path / "opened", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" >> "{opened}"\n', encoding="utf-8")
    browser.chmod(0o755)
    screen = {"DISPLAY": ":0", "BROWSER": f"{browser} %s"}
    words = filter(None, ("demo", "--pace", "1", option))
    with on_terminal(arguments(*words, folder=tmp_path / "data"), {**QUICK, **screen}) as terminal:
        terminal.until(r"dashboard: \S+ .*\)")
        (url,) = re.findall(r"dashboard: (\S+)", terminal.written)
        if not option:
            until(lambda: opened.exists() and opened.read_text(encoding="utf-8"), "the browser's start")
        assert terminal.interrupt() == 130
    assert ("opened in your browser" in terminal.written) == (not option)
    assert opened.exists() == (not option)
    assert option or opened.read_text(encoding="utf-8").split() == [url]
