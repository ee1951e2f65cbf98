"""A set whose file has no rows yet: the next start makes those that the killed recorder would have made."""

from dataclasses import replace

import numpy as np
import pytest
from support.memory_line import KilledError
from support.small_experiment import disturbed_rig, rows_of, run, small_settings

from daq_service.catalogue import RecorderCatalogue
from hardware_drivers.errors import AcquisitionTimeoutError, ConnectionLostError


def clipped(acquired):
    """Return the same strike at a range that is too small for its incident wave."""
    waveform = acquired.waveform
    low, high = waveform.calibration.full_scale_counts
    counts = np.clip(waveform.counts * (1.1 * high / waveform.counts.max()), low, high)
    return replace(acquired, waveform=replace(waveform, counts=counts.astype(waveform.counts.dtype)))


def test_rows_made_from_an_orphaned_file_are_those_of_the_recorder(tmp_path, monkeypatch):
    """Missed, superseded and lost shots, and the trouble that ended the set: all are in the file."""

    def disturb(key, acquired):
        if key.set_index == 1 and key.attempt == 0 and (key.position, key.shot_index) == ("B", 0):
            raise AcquisitionTimeoutError("no trigger within 5 s")
        if key.set_index == 1 and key.attempt == 0 and (key.position, key.shot_index) == ("B", 1):
            return clipped(acquired)
        if key.set_index == 1 and key.position == "C":
            raise ConnectionLostError("the board does not answer")
        return acquired

    def killing(self, commit):
        if commit.sets and commit.sets[0].set_index == 1:
            raise KilledError
        return commit_set(self, commit)

    settings = small_settings(schedule={"end_h": 2.0})
    settings = settings.model_copy(update={"positions": {name: settings.positions[name] for name in "ABC"}})
    assert run(settings, tmp_path / "whole", rig=disturbed_rig(disturb))
    whole = rows_of(tmp_path / "whole")
    assert {row.kind for row in whole["alarms"]} == {"instruments_unavailable"}
    commit_set = RecorderCatalogue.commit_set
    with monkeypatch.context() as patch:
        patch.setattr(RecorderCatalogue, "commit_set", killing)
        with pytest.raises(KilledError):
            run(settings, tmp_path / "killed", rig=disturbed_rig(disturb))
    assert run(settings, tmp_path / "killed")
    assert rows_of(tmp_path / "killed") == whole
