import pytest

from daq_service.clock import MachineClock, TimeLine, boot_name
from daq_service.processes.heartbeat import (
    FILE_NAME,
    Beat,
    Heartbeat,
    compute_beat_age_s,
    compute_test_time_ns,
    encode_heartbeat,
    extract_time_line,
    parse_beat,
    read_heartbeat,
)
from hardware_drivers.nanoseconds import NS_PER_S

LINE = TimeLine(utc_ns=5_000, elapsed_ns=700)


class FakeMonotonic:
    def __init__(self):
        self.now_ns = 1_000_000_000
        self.cost_ns = 0

    def __call__(self):
        """Return the time; the next call returns `cost_ns` more."""
        now_ns = self.now_ns
        self.now_ns += self.cost_ns
        return now_ns


def test_without_a_recorder_there_is_no_heartbeat(tmp_path):
    assert read_heartbeat(tmp_path) is None


def test_a_beat_hands_the_time_of_the_test_to_the_next_recorder_on_its_boot(tmp_path):
    Heartbeat(
        tmp_path, deadline_s=65.0, machine=MachineClock(boot_name=lambda: "ours"), time_line=lambda: LINE
    ).beat("waiting")
    beat = read_heartbeat(tmp_path)
    assert extract_time_line(beat, boot="ours", elapsed_ns=700) == LINE
    assert (
        compute_test_time_ns(beat, machine=MachineClock(boot_name=lambda: "ours", elapsed_ns=lambda: 900))
        == 5_200
    )


@pytest.mark.parametrize(
    ("written_in", "line", "boot", "elapsed_ns"),
    [
        ("another", LINE, "ours", 900),
        (None, LINE, None, 900),  # who knows
        ("ours", LINE, "ours", 699),  # a name that was used twice
        ("ours", None, "ours", 900),
    ],
)
def test_no_time_of_another_boot_is_used(tmp_path, written_in, line, boot, elapsed_ns):
    Heartbeat(
        tmp_path, deadline_s=65.0, machine=MachineClock(boot_name=lambda: written_in), time_line=lambda: line
    ).beat("waiting")
    beat = read_heartbeat(tmp_path)
    assert beat is not None
    assert extract_time_line(beat, boot=boot, elapsed_ns=elapsed_ns) is None
    assert (
        compute_test_time_ns(
            beat, machine=MachineClock(boot_name=lambda: boot, elapsed_ns=lambda: elapsed_ns)
        )
        is None
    )


def test_a_beat_has_the_activity_and_its_deadline(tmp_path):
    clock = FakeMonotonic()
    Heartbeat(tmp_path, deadline_s=65.0, machine=MachineClock(mono_ns=clock)).beat("taking set 3")
    beat = read_heartbeat(tmp_path)
    assert (beat.doing, beat.deadline_s, beat.mono_ns) == ("taking set 3", 65.0, clock.now_ns)
    assert beat.boot == boot_name()
    assert compute_beat_age_s(beat, boot=boot_name(), mono_ns=clock.now_ns + 64_000_000_000) == 64.0


def test_the_start_of_a_long_wait_is_written_even_if_a_beat_is_slow(tmp_path):
    clock = FakeMonotonic()
    clock.cost_ns = NS_PER_S // 100
    heartbeat = Heartbeat(tmp_path, deadline_s=65.0, machine=MachineClock(mono_ns=clock))
    heartbeat.beat("taking set 3")
    clock.cost_ns = 0
    heartbeat.beat("told later: the last beat was dear")
    heartbeat.beat("waiting for a person", at_once=True)
    beat = read_heartbeat(tmp_path)
    assert (beat.doing, beat.mono_ns) == ("waiting for a person", clock.now_ns)


def test_the_file_is_written_at_most_twice_a_second(tmp_path):
    clock = FakeMonotonic()
    heartbeat = Heartbeat(tmp_path, deadline_s=65.0, machine=MachineClock(mono_ns=clock))
    seen = []
    for _ in range(100):
        heartbeat.beat("waiting")
        beat = read_heartbeat(tmp_path)
        seen.append(beat.mono_ns)
        clock.now_ns += 20_000_000
    # 2 s in steps of 20 ms: a write every 500 ms, and the first one.
    assert len(set(seen)) == 4


def test_a_new_activity_is_written_immediately_unless_beats_are_slow(tmp_path):
    def count_writes(cost_ns):
        clock = FakeMonotonic()
        heartbeat = Heartbeat(tmp_path, deadline_s=65.0, machine=MachineClock(mono_ns=clock))
        seen = set()
        for number in range(100):  # a stage every 5 ms
            before = read_heartbeat(tmp_path)
            clock.cost_ns = cost_ns
            heartbeat.beat(f"stage {number}, {cost_ns}")
            clock.cost_ns = 0
            after = read_heartbeat(tmp_path)
            if before is None or after.doing != before.doing:
                seen.add(after.doing)
            clock.now_ns += 5_000_000
        return len(seen)

    assert count_writes(cost_ns=0) == 100
    # 0.5 s and the looks at the clock; a beat is followed by 100 ms without another.
    assert 4 <= count_writes(cost_ns=1_000_000) <= 7


def test_an_activity_after_a_wait_is_written_even_if_the_last_beat_is_recent(tmp_path):
    """A call that hangs immediately must be identified by its name."""
    clock = FakeMonotonic()
    heartbeat = Heartbeat(tmp_path, deadline_s=65.0, machine=MachineClock(mono_ns=clock))
    clock.cost_ns = 4_000_000  # for each read of the clock: a slow disk
    for _ in range(3):
        heartbeat.beat("waiting for set 1")
        clock.now_ns += 600_000_000
    heartbeat.beat("waiting for set 1")
    clock.now_ns += 10_000_000
    heartbeat.beat("taking set 1")
    beat = read_heartbeat(tmp_path)
    assert beat.doing == "taking set 1"


@pytest.mark.parametrize(
    "text",
    ["", "{", '{"process": 1, "mono_ns": 5', "[]", "null", '{"process": 1}', '{"mono_ns": "x"}', "\x00" * 80],
)
def test_an_invalid_heartbeat_counts_as_none_and_is_logged_once(tmp_path, caplog, text):
    (tmp_path / FILE_NAME).write_text(text, encoding="utf-8")
    assert [read_heartbeat(tmp_path) for _ in range(3)] == [None] * 3
    (warning,) = caplog.records
    assert "is no heartbeat and counts as none" in warning.getMessage()
    assert warning.exc_info is None


def test_an_inaccessible_heartbeat_file_is_logged_once_and_stops_nothing(tmp_path, caplog):
    (tmp_path / FILE_NAME).mkdir()
    clock, beats = FakeMonotonic(), []
    heartbeat = Heartbeat(
        tmp_path,
        deadline_s=65.0,
        machine=MachineClock(mono_ns=clock),
        notify=lambda event, **values: beats.append(parse_beat(values)),
    )
    for number in range(3):
        heartbeat.beat(f"set {number}")
        clock.now_ns += NS_PER_S
    assert read_heartbeat(tmp_path) is None
    (warning,) = caplog.records
    assert "cannot be written" in warning.getMessage()
    assert [beat.doing for beat in beats] == ["set 0", "set 1", "set 2"]


def test_a_heartbeat_of_an_older_version_has_no_boot(tmp_path):
    text = '{"process": 7, "mono_ns": 5, "deadline_s": 65.0, "doing": "waiting"}'
    (tmp_path / FILE_NAME).write_text(text, encoding="utf-8")
    beat = read_heartbeat(tmp_path)
    assert beat.boot is None
    assert compute_beat_age_s(beat, boot="ours", mono_ns=7) == 2e-9
    assert compute_beat_age_s(beat, boot="ours", mono_ns=4) is None


def test_a_beat_is_written_over_the_one_before_in_place(tmp_path):
    """No rename collides with a reader (Windows), and a full disk already has the space."""
    clock = FakeMonotonic()
    heartbeat = Heartbeat(tmp_path, deadline_s=65.0, machine=MachineClock(mono_ns=clock))
    heartbeat.beat("\N{SNOWMAN}" * 10_000)
    path = tmp_path / FILE_NAME
    before = path.stat()
    with path.open("rb"):
        clock.now_ns += NS_PER_S
        heartbeat.beat("waiting")
    assert (path.stat().st_ino, path.stat().st_size) == (before.st_ino, before.st_size)
    beat = read_heartbeat(tmp_path)
    assert beat.doing == "waiting"


def test_a_read_during_a_write_is_repeated(tmp_path, monkeypatch):
    """Every mixture of two beats is rejected; then the complete beat is read."""
    old, new = (
        encode_heartbeat(Beat(process=1, mono_ns=mono_ns, deadline_s=65.0, doing=doing))
        for mono_ns, doing in ((1_999_999_999, "taking set 9"), (2_000_000_000, "taking set 10"))
    )
    torn = {new[:size] + old[size:] for size in range(len(new))} - {old, new}
    assert len(torn) > 10
    for mixture in torn:
        reads = [mixture, new]
        monkeypatch.setattr(
            "daq_service.processes.heartbeat.read_best_effort", lambda path, reads=reads: reads.pop(0)
        )
        beat = read_heartbeat(tmp_path)
        assert (beat.mono_ns, beat.doing) == (2_000_000_000, "taking set 10")
