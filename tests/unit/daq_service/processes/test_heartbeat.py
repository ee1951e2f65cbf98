from pathlib import Path

from daq_service.processes.heartbeat import Heartbeat, overdue_s, read_heartbeat


class FakeMonotonic:
    def __init__(self) -> None:
        self.now_ns = 1_000_000_000
        self.cost_ns = 0

    def __call__(self) -> int:
        """Tell the time; the next look comes `cost_ns` later."""
        now_ns = self.now_ns
        self.now_ns += self.cost_ns
        return now_ns


def test_no_recorder_no_heartbeat(tmp_path: Path) -> None:
    assert read_heartbeat(tmp_path) is None


def test_a_beat_tells_what_is_done_and_until_when(tmp_path: Path) -> None:
    clock = FakeMonotonic()
    Heartbeat(tmp_path, deadline_s=65.0, mono_ns=clock).beat("taking set 3")
    beat = read_heartbeat(tmp_path)
    assert beat is not None
    assert (beat.doing, beat.deadline_s, beat.mono_ns) == ("taking set 3", 65.0, clock.now_ns)
    assert overdue_s(beat, mono_ns=clock.now_ns + 64_000_000_000) == -1.0
    assert overdue_s(beat, mono_ns=clock.now_ns + 67_000_000_000) == 2.0


def test_the_file_is_written_at_most_twice_a_second(tmp_path: Path) -> None:
    clock = FakeMonotonic()
    heartbeat = Heartbeat(tmp_path, deadline_s=65.0, mono_ns=clock)
    seen = []
    for _ in range(100):
        heartbeat.beat("waiting")
        beat = read_heartbeat(tmp_path)
        assert beat is not None
        seen.append(beat.mono_ns)
        clock.now_ns += 20_000_000
    # 2 s in steps of 20 ms: a write every 500 ms, and the first one.
    assert len(set(seen)) == 4


def test_news_comes_at_once_unless_the_last_beat_cost_too_much(tmp_path: Path) -> None:
    def writes(cost_ns: int) -> int:
        clock = FakeMonotonic()
        heartbeat = Heartbeat(tmp_path, deadline_s=65.0, mono_ns=clock)
        seen = set()
        for number in range(100):  # a stage every 5 ms
            before = read_heartbeat(tmp_path)
            clock.cost_ns = cost_ns
            heartbeat.beat(f"stage {number}, {cost_ns}")
            clock.cost_ns = 0
            after = read_heartbeat(tmp_path)
            assert after is not None
            if before is None or after.doing != before.doing:
                seen.add(after.doing)
            clock.now_ns += 5_000_000
        return len(seen)

    assert writes(cost_ns=0) == 100
    # 0.5 s and the looks at the clock; a beat is followed by 100 ms without another.
    assert 4 <= writes(cost_ns=1_000_000) <= 7


def test_nothing_half_written_is_left(tmp_path: Path) -> None:
    Heartbeat(tmp_path, deadline_s=65.0).beat("waiting")
    assert [path.name for path in tmp_path.iterdir()] == ["heartbeat.json"]
