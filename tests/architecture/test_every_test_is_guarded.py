"""Tests that leave something behind, hang or swallow a warning fail: shown on tests that do so on purpose."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

TESTS = Path(__file__).parents[1]

INNER_PYTEST = (
    sys.executable,
    "-m",
    "pytest",
    "-p",
    "no:cacheprovider",
    "-c",
    TESTS.parent / "pyproject.toml",
)
CONFTEST = """
from support.leaks import LeakGuard, mark_descendants

def pytest_configure(config):
    mark_descendants()
    config.pluginmanager.register(LeakGuard(grace_s=0.5))
"""

WRONGDOERS = '''
import os, subprocess, sys, threading
import pytest

kept = []
WAIT_FOR_INPUT = [sys.executable, "-c", "input()"]
WITH_A_CHILD = """
import subprocess, sys
child = subprocess.Popen([sys.executable, "-c", "input()"])
print(child.pid, flush=True)
"""


def test_leaves_a_thread():
    thread = threading.Thread(target=threading.Event().wait, name="forgotten", daemon=True)
    thread.start()


def test_leaves_a_process():
    kept.append(subprocess.Popen(WAIT_FOR_INPUT, stdin=subprocess.PIPE))
    kept[-1].stdin, there = None, kept[-1].stdin
    kept.append(there)


def test_leaves_an_orphan():
    here, there = os.pipe()
    kept.append(there)  # closed when this interpreter ends, and then the orphan ends too
    subprocess.run([sys.executable, "-c", WITH_A_CHILD], stdin=here, check=True)
    os.close(here)


def test_leaves_an_open_file():
    kept.append(open(__file__))


def test_drops_an_open_file():
    open(__file__)


@pytest.mark.timeout(0.5)
def test_hangs():
    threading.Event().wait()


def test_ends_all_in_time():
    thread = threading.Timer(0.01, print)
    thread.start()
'''

WIDE = """
import subprocess, sys, threading
from concurrent.futures import ThreadPoolExecutor
import pytest

@pytest.fixture(scope="module")
def pool():
    with ThreadPoolExecutor(2) as pool:
        pool.submit(int).result()
        yield pool

def test_the_pool_grows(pool):
    at_once = threading.Barrier(2)
    for waiting in [pool.submit(at_once.wait, 60.0) for _ in range(2)]:
        waiting.result()

def test_leaves_a_thread_beside_the_pool(pool):
    threading.Thread(target=threading.Event().wait, name="forgotten", daemon=True).start()

def test_is_the_last_with_the_pool(pool):
    pass
"""


CONFTEST_OF_THE_DEAF = """
from support.hangs import HangGuard

def pytest_configure(config):
    config.pluginmanager.register(HangGuard(grace_s=0.5))
"""
DEAF = """
import signal, threading
import pytest

@pytest.mark.timeout(0.5)
def test_hears_no_signal():
    {hang}
"""
HANGS = {
    # As in a call of C that restarts when a signal interrupts it.
    "to signals": "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM}); threading.Event().wait()",
    "to its own end": """while True:
        try:
            threading.Event().wait()
        except BaseException:
            pass""",
}


@pytest.fixture(scope="module")
def failures(tmp_path_factory):
    """Run these tests like the suite; return the failure message of each, "" if it passed."""
    folder = tmp_path_factory.mktemp("guarded")
    for name, text in (("conftest", CONFTEST), ("test_wrongdoers", WRONGDOERS), ("test_wide", WIDE)):
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    report = folder / "report.xml"
    paths = [str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [*INNER_PYTEST, "--junit-xml", report, "--rootdir", folder, folder],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert report.exists(), done.stdout + done.stderr
    return {
        case.attrib["name"]: " ".join(found.attrib["message"] for found in case if "message" in found.attrib)
        for case in ElementTree.parse(report).iter("testcase")
    }


def test_a_thread_left_behind_fails_its_test(failures):
    assert "left behind: thread 'forgotten'" in failures["test_leaves_a_thread"]
    assert failures["test_ends_all_in_time"] == ""


@pytest.mark.skipif(sys.platform != "linux", reason="orphans and open files are looked up in /proc")
def test_a_process_or_an_open_file_left_behind_fails_its_test(failures):
    assert "; process " in failures["test_leaves_a_process"]
    assert "process " in failures["test_leaves_an_orphan"]
    assert "test_wrongdoers.py)" in failures["test_leaves_an_open_file"]


def test_a_module_fixture_may_keep_its_threads_until_it_ends(failures):
    assert failures["test_the_pool_grows"] == ""
    assert "left behind: thread 'forgotten'" in failures["test_is_the_last_with_the_pool"]
    assert "::test_leaves_a_thread_beside_the_pool" in failures["test_is_the_last_with_the_pool"]
    assert "ThreadPool" not in failures["test_is_the_last_with_the_pool"]


def test_a_warning_that_cannot_be_caught_fails_its_test(failures):
    assert "PytestUnraisableExceptionWarning" in failures["test_drops_an_open_file"]


@pytest.mark.skipif(sys.platform == "win32", reason="there the time limit is no signal")
@pytest.mark.parametrize("hang", HANGS.values(), ids=HANGS.keys())
def test_a_test_that_nothing_can_interrupt_ends_its_process(hang, tmp_path):
    (tmp_path / "conftest.py").write_text(CONFTEST_OF_THE_DEAF, encoding="utf-8")
    (tmp_path / "test_deaf.py").write_text(DEAF.format(hang=hang), encoding="utf-8")
    done = subprocess.run(
        [*INNER_PYTEST, "--rootdir", tmp_path, tmp_path],
        env={**os.environ, "PYTHONPATH": str(TESTS)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "in test_hears_no_signal" in done.stderr


def test_every_test_has_a_time_limit(failures, request):
    assert "Timeout" in failures["test_hangs"]
    assert 0.0 < float(request.config.getini("timeout")) <= 300.0
