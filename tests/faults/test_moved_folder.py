"""A data folder that is moved away under a running test and comes back: nothing is lost."""

import logging
import shutil
import sys

import pytest
from support.small_experiment import SMALL, disturbed_rig, rows_of, run, small_settings

SHORT = {**SMALL["schedule"], "end_h": 3.0}
MOVED_IN_SET = 2


@pytest.mark.skipif(sys.platform == "win32", reason="Windows renames no folder in which files are open")
def test_sets_wait_for_the_tests_own_folder(tmp_path):
    undisturbed, data, elsewhere = (tmp_path / name for name in ("undisturbed", "data", "elsewhere"))
    messages = []

    def move_away(key, acquired):
        if (key.set_index, key.shot_index, key.position) == (MOVED_IN_SET, 0, "B"):
            data.rename(elsewhere)
            (data / "sets").mkdir(parents=True)  # another one in its place
        return acquired

    class BringBack(logging.Handler):
        """Person who reads that nothing is stored and restores the folder."""

        def emit(self, record):
            if "not stored" in record.getMessage() and elsewhere.exists():
                messages.append(record.getMessage())
                assert [path.name for path in data.glob("*/*")] == []
                shutil.rmtree(data, ignore_errors=True)
                elsewhere.rename(data)

    assert run(small_settings(schedule=SHORT), undisturbed)
    reading = BringBack()
    log = logging.getLogger("daq_service.recording.persistence")
    log.addHandler(reading)
    try:
        assert run(small_settings(schedule=SHORT), data, rig=disturbed_rig(move_away))
    finally:
        log.removeHandler(reading)
    assert ["not the folder of this test" in message for message in messages] == [True]
    expected, found = rows_of(undisturbed), rows_of(data)
    alarms = [row for row in found.pop("alarms") if row not in expected["alarms"]]
    assert [(row.kind, row.state) for row in alarms] == [("write_failed", "returned_unacknowledged")]
    assert found == {name: rows for name, rows in expected.items() if name != "alarms"}
    files = {path.name: path.read_bytes() for path in (undisturbed / "sets").iterdir()}
    assert files.keys() == {path.name for path in (data / "sets").iterdir()}
