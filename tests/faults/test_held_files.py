"""Files that are held for a moment, as scanners do on Windows: nothing ends, nothing is lost."""

import errno
import json
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections import Counter
from pathlib import Path

import pytest
from support.refusing_files import build, needs_a_preload, refusing
from support.small_experiment import SMALL, rows_of, run, small_settings
from support.waiting import until

pytestmark = needs_a_preload

SHORT = {**SMALL["schedule"], "end_h": 3.0}
CALLS = "open,read,rename,unlink"
ROUTES = ("", "static/main.js", "api/v1/health", "api/v1/transducers", "api/v1/waveforms/live/B")
HELD = {"once": "first 0", "for half a second": "first 500", "one call in a hundred": "rate 10"}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return build(tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    assert run(small_settings(schedule=SHORT), folder)
    return rows_of(folder)


def written(folder: Path) -> Path:
    config = folder / "test.json"
    config.write_text(json.dumps({**SMALL, "schedule": SHORT}), encoding="utf-8")
    return config


def asked(url: str) -> tuple[int, bytes]:
    try:
        with urllib.request.urlopen(url, timeout=60.0) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read()


@pytest.mark.parametrize(
    "when",
    [
        pytest.param(when, id=name, marks=[] if when == "first 0" else pytest.mark.slow)
        for name, when in HELD.items()
    ],
)
def test_recorder_supervisor_and_web_survive_held_files(library, undisturbed, tmp_path, when):
    data, log = tmp_path / "data", tmp_path / "refused"
    command = [
        sys.executable,
        "-m",
        "daq_service.cli",
        "run",
        written(tmp_path),
        "--data-dir",
        data,
        "--port",
        "0",
    ]
    held = refusing(library, data, calls=CALLS, errno=errno.EACCES, when=when, log=log)
    with subprocess.Popen(
        command, env=held, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            url = next(line for line in process.stdout if "dashboard: " in line).split()[-1]
            answers = Counter()

            def finished():
                got = {route: asked(url + route) for route in ROUTES}
                answers.update(status for status, _ in got.values())
                status, body = got["api/v1/health"]
                return status == 200 and json.loads(body)["recorder"]["state"] == "finished"

            until(finished, "the end of the schedule")
        finally:
            process.send_signal(signal.SIGTERM)
            output, _ = process.communicate(timeout=60.0)
    assert process.returncode == 130, output
    assert "Traceback" not in output
    logs = "".join(path.read_text(encoding="utf-8") for path in (data / "logs").glob("*.log"))
    assert "Traceback" not in logs
    assert "started again" not in logs, "no process ended before its time"
    assert answers[200] >= len(ROUTES)
    assert set(answers) <= {200, 404, 503}, "not yet, or not now; a fault would be 500"
    assert rows_of(data) == undisturbed
    assert not list((data / "sets").glob("*.tmp"))
    noted = [line.split(" ", 1) for line in log.read_text(encoding="utf-8").splitlines()]
    files = {Path(path).name for _, path in noted}
    assert {call for call, _ in noted} >= set(CALLS.split(",")) - {"unlink"}
    if when != "rate 10":
        assert {
            "catalogue.sqlite",
            "recorder.lock",
            "heartbeat.json",
            "B.bin",
            "recorder.log",
            "web.log",
        } <= files
        assert any(name.startswith("set_") for name in files)
