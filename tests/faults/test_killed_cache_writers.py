"""A process that is killed between writing and renaming a cached file leaves nothing that is read."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from simulator.numerics.array_cache import STALE_S, read_or_compute_arrays

STOPPING = """
import sys
from pathlib import Path
import numpy as np
from simulator.numerics.array_cache import read_or_compute_arrays

def stop(path, target):
    print("written", flush=True)
    sys.stdin.readline()

Path.replace = stop
read_or_compute_arrays(Path(sys.argv[1]), "key", lambda: {"a": np.arange(10_000.0)})
"""
"""Stops when a file is complete but has not yet its name, and reports it."""


def test_a_writer_killed_before_it_renames_leaves_a_file_that_is_never_read_and_is_swept(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", STOPPING, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout.readline().split() == [b"written"]
        process.kill()
    (unfinished,) = tmp_path.iterdir()
    assert unfinished.suffix == ".part"
    found = read_or_compute_arrays(tmp_path, "key", lambda: {"a": np.ones(3)})
    assert found["a"].tolist() == [1.0] * 3, "computed again"
    assert unfinished.exists(), "its writer might be at work"
    os.utime(unfinished, (time.time() - 2.0 * STALE_S,) * 2)
    read_or_compute_arrays(tmp_path, "key", lambda: pytest.fail("key was not kept"))
    assert [path.suffix for path in tmp_path.iterdir()] == [".arrays"]
