"""Generated requests, good and bad, against the OpenAPI document: every check of schemathesis, no failure.

One short run by default; the long ones, over an empty, a full and a live folder and with each role's token::

    pytest -m slow tests/contract/test_schemathesis.py
"""

import itertools
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.filled_folder import filled_folder
from support.served_web import served

from daq_service.settings.tree import Settings
from daq_service.web.auth.roles import ROLES
from daq_service.web.auth.tokens import create_token

CONFIGURATION = Path(__file__).with_name("schemathesis.toml")
DOCUMENT = Path(__file__).with_name("openapi.json")
"""As served (test_openapi.py), but to be had without a token."""
LONG = ("--phases", "examples,coverage,fuzzing,stateful", "--max-examples", "40")
SHORT = ("--phases", "fuzzing", "--max-examples", "1", "--generation-deterministic")
DRAWN = ("--exclude-operation-id", "get_report")
"""Takes as long as all others together; tests/unit/daq_service/web/test_web_report.py asks for it."""
ENDLESS = "stream_events"
"""An answer that does not end; tests/unit/daq_service/web/test_web_stream.py follows it."""


@pytest.fixture
def full(tmp_path):
    with filled_folder(tmp_path, Settings(clock={"pace_h_per_s": 5.0})) as folder:
        for index in range(3):
            folder.add_set(index, shown=index == 2)
        folder.add_alarm("B", 2)
        folder.add_environment(2)
        yield folder


def assert_nothing_is_found(url, tmp_path, *options, token=None, configuration=CONFIGURATION):
    authorization = () if token is None else ("--header", f"Authorization: Bearer {token}")
    # A process of its own: its plugin for pytest would be imported by every run of every test.
    command = [sys.executable, "-m", "schemathesis.cli", "--config-file", str(configuration), "--no-color"]
    command += ["run", str(DOCUMENT), "--url", url, "--checks", "all", "--exclude-operation-id", ENDLESS]
    done = subprocess.run(
        [*command, "--warnings", "off", "--request-timeout", "60", *options, *authorization],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        encoding="utf-8",
        env={"PYTHONIOENCODING": "utf-8", "PATH": ""} if sys.platform != "win32" else None,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Tested: " in done.stdout
    return done.stdout


def test_a_short_run_finds_nothing(full, tmp_path):
    with served(full.settings, full.folder) as service:
        assert_nothing_is_found(service.url, tmp_path, *SHORT, *DRAWN)


@contextmanager
def going_on(folder):
    """Add sets continuously, as a recorder does."""
    stop = threading.Event()

    def record():
        for index in itertools.takewhile(lambda _: not stop.is_set(), range(3, len(folder.due))):
            folder.add_set(index, shown=True)
            folder.beat()

    recorder = threading.Thread(target=record)
    recorder.start()
    try:
        yield
    finally:
        stop.set()
        recorder.join()


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_nothing_is_found_over_a_full_folder(full, tmp_path):
    with served(full.settings, full.folder) as service:
        assert_nothing_is_found(service.url, tmp_path, *LONG)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_nothing_is_found_over_a_folder_that_is_being_written(full, tmp_path):
    with going_on(full), served(full.settings, full.folder) as service:
        assert_nothing_is_found(service.url, tmp_path, *LONG)


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_nothing_is_found_over_an_empty_folder(tmp_path):
    # "No data yet" is what such a service shall say.
    configuration = tmp_path / "empty.toml"
    allowed = '[checks.not_a_server_error]\nexpected-statuses = ["2xx", "3xx", "4xx", 503]\n'
    configuration.write_text(CONFIGURATION.read_text(encoding="utf-8") + allowed, encoding="utf-8")
    with served(Settings(), tmp_path) as service:
        assert_nothing_is_found(service.url, tmp_path, *LONG, configuration=configuration)


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("who", [*ROLES, "nobody", "wrong"])
def test_schemathesis_finds_no_fault_for_any_role(full, tmp_path, who):
    texts = {role: create_token(tmp_path / "tokens.json", f"the-{role}", role)[1] for role in ROLES}
    token = {**texts, "nobody": None, "wrong": "x" * 43}[who]
    with served(full.settings, full.folder) as service, service.client() as api:
        assert_nothing_is_found(service.url, tmp_path, *LONG, token=token)
        if who in ROLES:
            api.headers["Authorization"] = f"Bearer {token}"
            assert api.get("/api/v1/session").json()["role"] == who, "nothing generated has revoked it"
