"""A recorder keeps no stored sets: its memory does not grow with the test."""

import gc
import tracemalloc
from collections import deque

from support.memory_archive import MemoryArchive
from support.memory_line import Line, healthy, memory_settings

BEGIN, FIRST, LAST = 10, 40, 100
MOST_BYTES = 30_000
"""500 B a set, one row kept of each, or 40 B a shot, its id kept. Some 20 kB come and go: SQLite's list of
cursors is cleared every 200, checksums of the last 64 records are remembered."""


class ForgetfulArchive(MemoryArchive):
    """Archive double that keeps no stored data, as a disk uses no memory."""

    def store_set(self, record):
        stored = super().store_set(record)
        self.shelf.sets.clear()
        return stored


def test_stored_sets_use_no_memory(tmp_path):
    settings = memory_settings(
        schedule={"phases": [{"until_h": (LAST + 1) / 2, "interval_h": 0.5}], "shots_per_set": 4},
        baseline={"minimum_valid_shots": 1},
    )
    line, traced = Line(tmp_path, settings), {}

    def script(key):
        if key.position == "D" and key.set_index in (BEGIN, FIRST, LAST) and key.set_index not in traced:
            line.instruments[0].calls, line.heartbeat.activities = deque(maxlen=1), deque(maxlen=1)
            gc.collect()
            if key.set_index == BEGIN:  # long-lived objects are allocated before `FIRST`
                tracemalloc.start()
            traced[key.set_index] = tracemalloc.get_traced_memory()[0]
            if key.set_index == LAST:
                tracemalloc.stop()
        return healthy(key)

    line.script = script
    line.listen_every_s = 1e9  # the number of command polls is not tested here
    assert line.run(archive=ForgetfulArchive(line.shelf))
    assert traced[LAST] - traced[FIRST] < MOST_BYTES
