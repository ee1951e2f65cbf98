"""The container file without a container: what it copies, runs, asks and starts is there and works."""

import json
import re
import subprocess
import sys
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from support.command_line import command_of

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "examples" / "container" / "Dockerfile").read_text(encoding="utf-8")
LINES = re.sub(r"\\\n", " ", re.sub(r"^#.*\n", "", TEXT, flags=re.MULTILINE)).splitlines()
STEPS = [tuple(line.split(maxsplit=1)) for line in LINES if line.strip()]
"""Each instruction and its arguments, in order."""


def arguments_of(instruction):
    return [words for name, words in STEPS if name == instruction]


def test_every_instruction_is_one():
    known = {"FROM", "WORKDIR", "COPY", "RUN", "USER", "VOLUME", "EXPOSE", "HEALTHCHECK", "ENTRYPOINT", "CMD"}
    assert {name for name, _ in STEPS} <= known
    assert [words.partition(" ")[0] for words in arguments_of("FROM")] == ["python:3.11-slim"] * 2, (
        "no registry's host"
    )


def test_every_copied_file_exists():
    here = [words.split()[:-1] for words in arguments_of("COPY") if not words.startswith("--from")]
    assert [name for names in here for name in names if not (ROOT / name).exists()] == []


def test_the_container_has_the_packages_of_the_demonstration():
    *_, install = [words for words in arguments_of("RUN") if "pip install" in words]
    assert '"$(ls /wheel/*.whl)[demo]"' in install


def test_the_container_runs_as_an_unprivileged_user_on_its_own_folder():
    last = STEPS[max(index for index, step in enumerate(STEPS) if step[0] == "FROM") :]
    order = [step for step in last if step[0] in ("RUN", "USER", "VOLUME", "ENTRYPOINT")]
    assert [name for name, _ in order] == ["RUN", "USER", "VOLUME", "ENTRYPOINT"]
    assert "useradd --create-home solimon" in order[0][1]
    assert "install -d -o solimon -g solimon /data" in order[0][1]
    assert (order[1][1], order[2][1]) == ("solimon", "/data")


def test_the_container_starts_our_command_on_its_exposed_port():
    program, *_ = json.loads(arguments_of("ENTRYPOINT")[0])
    word, *arguments = json.loads(arguments_of("CMD")[0])
    options = command_of(word).make_context(word, arguments).params
    assert (program, str(options["port"])) == ("solimon", arguments_of("EXPOSE")[0])
    assert options["data_dir"].is_relative_to(arguments_of("VOLUME")[0])


@contextmanager
def page(status):
    """Serve a page with this status; yield its port."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(status if self.path == "/healthz" else 404)
            self.end_headers()

        def log_message(self, *words):
            """Log nothing."""

    with HTTPServer(("127.0.0.1", 0), Page) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize(("status", "healthy"), [(200, True), (503, False), (None, False)])
def test_the_health_check_requests_the_page(status, healthy):
    python, dash_c, program = json.loads(arguments_of("HEALTHCHECK")[0].partition("CMD ")[2])
    assert (python, dash_c) == ("python", "-c")
    with page(status or 200) as port:
        asked = program.replace("8750", str(port))
        if status is not None:
            done = subprocess.run([sys.executable, "-c", asked], capture_output=True, check=False)
    if status is None:  # the client has gone
        done = subprocess.run([sys.executable, "-c", asked], capture_output=True, check=False)
    assert (done.returncode == 0) == healthy
