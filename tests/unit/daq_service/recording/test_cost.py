"""The stages of a run add up to its elapsed time."""

from itertools import accumulate

from daq_service.recording.recorder import Cost


def test_the_stages_add_up_to_the_elapsed_time():
    cost = Cost(accumulate([0.0, 1.0, 2.0, 4.0]).__next__)  # each reading of the clock is so much later
    with cost.of("commit_s"):
        pass
    cost.add_set({"fsync_s": 0.5})
    row = {name: value for name, value in cost.as_row().items() if value}
    assert row == {"sets": 1, "commit_s": 2.0, "fsync_s": 0.5, "other_s": 1.0 + 4.0 - 0.5}
