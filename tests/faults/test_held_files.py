"""Files that are held for a moment, as scanners do on Windows: nothing ends, nothing is lost."""

import errno
import json
import signal
import subprocess
import urllib.error
import urllib.request
from collections import Counter
from pathlib import Path

import pytest
from support.command_line import SOLIMON
from support.refusing_files import build, needs_a_preload, refusing
from support.small_experiment import SMALL, rows_of, run, small_settings
from support.waiting import until

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import SetRow

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


def written(folder):
    config = folder / "test.json"
    config.write_text(json.dumps({**SMALL, "schedule": SHORT}), encoding="utf-8")
    return config


def asked(url):
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
    command = [*SOLIMON, "run", written(tmp_path), "--data-dir", data, "--port", "0"]
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
    refused = {call for call, _ in noted}
    assert refused >= {"open", "read"}
    if when != "rate 10":  # few calls are refused there, and of the few renames often none
        assert refused >= set(CALLS.split(",")) - {"unlink"}
        assert {
            "catalogue.sqlite",
            "recorder.lock",
            "heartbeat.json",
            "B.bin",
            "recorder.log",
            "web.log",
        } <= files
        assert any(name.startswith("set_") for name in files)


def n_sets(data):
    try:
        with open_catalogue(data) as catalogue:
            return len({row.set_index for row in catalogue.rows(SetRow)})
    except NoDataYetError:
        return 0


@pytest.mark.parametrize(
    ("part", "number", "words"),
    [
        pytest.param("journal", errno.ENOSPC, "No space left on device", marks=pytest.mark.slow),
        pytest.param("journal", errno.EIO, "Input/output error", marks=pytest.mark.slow),
        pytest.param("sets", errno.ENOSPC, "No space left on device", marks=pytest.mark.slow),
        pytest.param("catalogue.sqlite", errno.ENOSPC, "database or disk is full", marks=pytest.mark.slow),
        pytest.param("catalogue.sqlite", errno.EIO, "disk I/O error", marks=pytest.mark.slow),
    ],
)
def test_a_disk_that_takes_nothing_is_waited_for(library, undisturbed, tmp_path, part, number, words):
    """From set 2 on every write to journal, sets or catalogue is refused until the fault ends."""
    data, log, broken = tmp_path / "data", tmp_path / "refused", tmp_path / "broken"
    environment = refusing(
        library, data / part, calls="write", errno=number, when="file", log=log, while_there=broken
    )
    environment["SOLIMON_CLOCK__PACE_H_PER_S"] = "1.0"
    command = [*SOLIMON, "record", written(tmp_path), "--data-dir", data]
    recorder_log = data / "logs" / "recorder.log"
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            until(lambda: n_sets(data) >= 2 or process.poll(), "the second set")
            broken.touch()
            message = "stays in the journal" if part == "sets" else "not stored"
            until(lambda: message in recorder_log.read_text() or process.poll(), "the trouble")
            broken.unlink()
            _, errors = process.communicate(timeout=120.0)
        finally:
            process.kill()
    assert process.returncode == 0, errors
    assert words in recorder_log.read_text()
    assert len(list(data.glob("sets/*.h5"))) == len({row.set_index for row in undisturbed["sets"]})
    assert list(data.glob("journal/*")) == []
    stored = rows_of(data)
    alarms = stored.pop("alarms")
    assert stored == {name: rows for name, rows in undisturbed.items() if name != "alarms"}
    assert [(row.kind, row.state) for row in alarms] == [("write_failed", "returned_unacknowledged")]
