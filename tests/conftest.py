"""Puts `tests/` on the import path, so that tests of every kind share `support`; guards and orders them."""

import gc
import os
import signal
import threading
from pathlib import Path

import pytest
from support.hangs import HangGuard
from support.leaks import LeakGuard, mark_descendants, open_what_lasts

for library in ("OPENBLAS", "OMP", "MKL"):
    # Tests run side by side: threads of theirs that wait for each other in loops would double the cost.
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")  # read once, when numpy is imported

# Else each process that a test starts compiles our sources again; compiled kernels are next to them anyway.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

SLOW_TEST_S = 3600.0
"""The longest of the tests marked slow takes a third of it."""

LAST = ("contract", "property", "unit")
"""Folders of short files: started last, so that no process is left alone with a long one."""
AFTER_COMPILATION = "test_wheel.py"
"""Takes along the kernels that the tests before it have compiled."""


def pytest_configure(config):
    # A shell ignores Ctrl-C for what it runs in the background, and our processes keep what is ignored.
    is_ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    if is_ignored and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # pytest-xdist would begin with the files of most tests, which are the shortest ones.
    config.option.loadscopereorder = False
    mark_descendants()
    open_what_lasts()
    config.pluginmanager.register(LeakGuard(), "leak-guard")
    config.pluginmanager.register(HangGuard(), "hang-guard")


def pytest_collection_finish():
    # Thousands of tests that never change would be searched for garbage again and again.
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items):
    here = Path(__file__).parent

    def turn(item):
        short = here in item.path.parents and item.path.relative_to(here).parts[0] in LAST
        return 2 if short else 1 if item.path.name == AFTER_COMPILATION else 0

    items.sort(key=turn)
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_TEST_S))
