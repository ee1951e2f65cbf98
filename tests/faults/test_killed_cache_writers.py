"""Processes that share an empty cache and are killed at random leave no wrong digit and nothing half-written.

They are real processes, killed by the operating system (SIGKILL, TerminateProcess) after a random number
of answers and a random moment more; each killed one has a successor. The seeds are fixed, the moments are
not: whatever comes, the same must hold. Some are killed for certain between writing and renaming.
"""

import hashlib
import os
import random
import subprocess
import sys
import time

import numpy as np
import pytest

from simulator.numerics.array_cache import STALE_S, read_arrays, read_or_compute_arrays

PROCESSES = 3
KILLS, KILLS_IN_WRITING = 6, 1

# Small answers, so that a process spends most of its time at the disk.
KEEPING = """
import hashlib, sys
from pathlib import Path
import numpy as np
from simulator.numerics.array_cache import cached_arrays

for number in range(int(sys.argv[2]), 100_000):
    compute = lambda: {"a": np.arange(10_000) / (number + 1.0), "b": np.array([[number, -0.0]])}
    arrays = cached_arrays(Path(sys.argv[1]), f"key{number}", compute)
    digest = hashlib.sha256(b"".join(values.tobytes() for values in arrays.values())).hexdigest()
    print(number, digest, flush=True)
"""

# Stops when a file is complete but has not yet its name, and says so.
STOPPING = (
    """
import sys
from pathlib import Path

def stop(path, target):
    print("written", flush=True)
    sys.stdin.readline()

Path.replace = stop
"""
    + KEEPING
)


def start(program, *arguments):
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,  # a line that is not asked for stays in the pipe
    )


def end(process, *, killed):
    """Return the complete lines of the remaining output."""
    if killed:
        process.kill()
    output, errors = process.communicate()
    assert errors == b""
    assert killed or process.returncode == 0
    return output[: output.rfind(b"\n") + 1].decode().splitlines()


def a_moment_more(process, seconds):
    """Let the process work on; it does not end by itself."""
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=seconds)


def keeping_digest(number):
    a, b = np.arange(10_000) / (number + 1.0), np.array([[number, -0.0]])
    return hashlib.sha256(a.tobytes() + b.tobytes()).hexdigest()


def age(folder):
    """Make the folder look unused for a long time."""
    for path in folder.iterdir():
        when = time.time() - 2.0 * STALE_S
        os.utime(path, (when, when))


def test_killed_writers_leave_whole_files_and_right_answers(tmp_path):
    chance = random.Random(20261121)
    workers = [start(KEEPING, tmp_path, 0) for _ in range(PROCESSES)]
    answers = []
    for number in range(KILLS):
        process = workers.pop(chance.randrange(PROCESSES))
        answers += [process.stdout.readline().decode() for _ in range(chance.randint(1, 60))]
        a_moment_more(process, chance.uniform(0.0, 5e-3))
        answers += end(process, killed=True)
        workers.append(start(KEEPING, tmp_path, 40 * number))  # others may be there already
    for number in range(KILLS_IN_WRITING):
        process = start(STOPPING, tmp_path, 90_000 + number)  # no other process comes so far
        assert process.stdout.readline().split() == [b"written"]
        answers += end(process, killed=True)
    for process in workers:
        answers.append(process.stdout.readline().decode())
        answers += end(process, killed=True)

    assert len(answers) > 100
    for number, digest in {tuple(answer.split()) for answer in answers}:
        assert digest == keeping_digest(int(number))
    kept = sorted(tmp_path.glob("*.arrays"))
    assert len(kept) > 40
    for path in kept:
        arrays = read_arrays(path)
        assert arrays is not None
        found = hashlib.sha256(b"".join(values.tobytes() for values in arrays.values())).hexdigest()
        assert found == keeping_digest(int(path.stem.removeprefix("key")))

    unfinished = [path for path in tmp_path.iterdir() if path not in kept]
    assert len(unfinished) >= KILLS_IN_WRITING
    assert {path.suffix for path in unfinished} == {".part"}
    read_or_compute_arrays(tmp_path, "key0", lambda: pytest.fail("key0 was not kept"))
    assert all(path.exists() for path in unfinished)  # young: their writers might be at work
    age(tmp_path)
    read_or_compute_arrays(tmp_path, "key0", lambda: pytest.fail("key0 was not kept"))
    assert sorted(tmp_path.iterdir()) == kept
