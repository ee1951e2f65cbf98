"""A recorder keeps no stored sets: its memory does not grow with the test."""

import gc
import tracemalloc
from array import array
from collections import deque

from support.memory_archive import MemoryArchive
from support.memory_line import Line, healthy, memory_settings

BEGIN, FIRST, LAST = 10, 120, 190
"""Caches, rollup levels and the tables of SQLAlchemy grow until set 110 and no more."""
EARLY, LATE = range(FIRST, FIRST + 25), range(LAST - 24, LAST + 1)
"""Some 25 kB come and go with a period of a dozen sets, because SQLite's list of cursors is cleared every 200
and the checksums of the last 64 records are remembered. So the minima of two windows are compared: two single
sets differ by their phase."""
MOST_BYTES = 9_000
"""It was 1 kB; one row kept of each set adds 14 kB, the ids of its shots 13 kB."""


class ForgetfulArchive(MemoryArchive):
    """Archive double that keeps no stored data, as a disk uses no memory."""

    def store_set(self, record):
        stored = super().store_set(record)
        self.shelf.sets.clear()
        return stored


def test_stored_sets_use_no_memory(tmp_path):
    settings = memory_settings(
        schedule={"phases": [{"until_h": (LAST + 1) / 2, "interval_h": 0.5}], "shots_per_set": 2},
        baseline={"minimum_valid_shots": 1},
    )
    line, traced = Line(tmp_path, settings), array("q", [0] * (LAST + 1))

    def script(key):
        if key.position == "D" and key.set_index in (BEGIN, *EARLY, *LATE) and not traced[key.set_index]:
            line.instruments[0].calls, line.heartbeat.activities = deque(maxlen=1), deque(maxlen=1)
            gc.collect()
            if key.set_index == BEGIN:  # long-lived objects are allocated before `FIRST`
                tracemalloc.start()
            traced[key.set_index] = max(tracemalloc.get_traced_memory()[0], 1)
            if key.set_index == LAST:
                tracemalloc.stop()
        return healthy(key)

    line.script = script
    line.listen_every_s = 1e9  # the number of command polls is not tested here
    assert line.run(archive=ForgetfulArchive(line.shelf))
    early, late = (min(traced[number] for number in window) for window in (EARLY, LATE))
    assert late - early < MOST_BYTES
