import pytest

from daq_service.clock import WINDOWS_BOOT_COUNTER, boot_name, format_utc, parse_utc, read_boot_id
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S
from simulator.clock import SimulatedClock


def always():
    return True


class FakeWall:
    """Wall time that advances only in sleep."""

    def __init__(self):
        self.now_ns = 5 * NS_PER_S

    def __call__(self):
        return self.now_ns

    def sleep(self, seconds):
        self.now_ns += round(seconds * NS_PER_S)


def test_a_time_survives_being_written_and_read():
    assert format_utc(parse_utc("2024-01-01T12:30:00.250Z"), 3) == "2024-01-01T12:30:00.250Z"


def test_a_time_east_of_greenwich_is_turned_into_utc():
    assert parse_utc("2024-01-01T02:00:00+02:00") == parse_utc("2024-01-01T00:00:00Z")


def test_a_time_without_an_offset_is_refused():
    with pytest.raises(ValueError, match="no UTC offset"):
        parse_utc("2024-01-01T00:00:00")


def test_the_simulated_clock_jumps_without_sleeping():
    wall = FakeWall()
    clock = SimulatedClock(0, mono_ns=wall, sleep=wall.sleep)
    assert clock.wait_until(350 * NS_PER_H, always)
    assert clock.utc_ns() == 350 * NS_PER_H
    assert wall.now_ns == 5 * NS_PER_S


def test_a_time_in_the_past_does_not_set_the_clock_back():
    clock = SimulatedClock(NS_PER_H)
    assert clock.wait_until(0, always)
    assert clock.utc_ns() == NS_PER_H


def test_a_paced_clock_takes_the_wall_time_of_its_pace():
    wall = FakeWall()
    clock = SimulatedClock(0, pace_h_per_s=5.0, mono_ns=wall, sleep=wall.sleep)
    assert clock.wait_until(10 * NS_PER_H, always)
    assert wall.now_ns - 5 * NS_PER_S == 2 * NS_PER_S


def test_work_between_two_waits_is_part_of_the_pace():
    wall = FakeWall()
    clock = SimulatedClock(0, pace_h_per_s=5.0, mono_ns=wall, sleep=wall.sleep)
    clock.wait_until(5 * NS_PER_H, always)
    wall.sleep(0.7)
    clock.wait_until(10 * NS_PER_H, always)
    assert wall.now_ns - 5 * NS_PER_S == 2 * NS_PER_S


def test_pacing_starts_with_the_first_wait():
    wall = FakeWall()
    clock = SimulatedClock(0, pace_h_per_s=5.0, mono_ns=wall, sleep=wall.sleep)
    wall.sleep(20.0)  # a rig that takes long to open
    start_ns = wall.now_ns
    clock.wait_until(5 * NS_PER_H, always)
    assert wall.now_ns - start_ns == NS_PER_S


def test_a_pace_that_is_not_kept_is_measured():
    wall = FakeWall()
    clock = SimulatedClock(0, pace_h_per_s=5.0, mono_ns=wall, sleep=wall.sleep)
    assert clock.measure_late_pace_h_per_s() is None, "nobody has waited yet"
    clock.wait_until(5 * NS_PER_H, always)
    wall.sleep(1.9)
    assert clock.measure_late_pace_h_per_s() is None, "a moment late"
    wall.sleep(2.1)
    assert clock.measure_late_pace_h_per_s() == pytest.approx(1.0)  # 5 h in 5 s
    clock.finish_now()
    assert clock.measure_late_pace_h_per_s() is None, "no pace is set"


def test_finish_now_ends_the_pacing():
    wall = FakeWall()
    clock = SimulatedClock(0, pace_h_per_s=1e-6, mono_ns=wall, sleep=wall.sleep)

    def idle():
        clock.finish_now()
        return True

    assert clock.wait_until(NS_PER_H, idle)
    assert clock.utc_ns() == NS_PER_H


def test_a_wait_ends_as_soon_as_idle_returns_false():
    wall = FakeWall()
    clock = SimulatedClock(0, pace_h_per_s=1.0, mono_ns=wall, sleep=wall.sleep)
    assert not clock.wait_until(NS_PER_H, lambda: wall.now_ns < 5.5 * NS_PER_S)
    assert clock.utc_ns() == 0, "time that nobody waited for must not pass"


def test_a_pace_of_zero_is_refused():
    with pytest.raises(ValueError, match="must be positive"):
        SimulatedClock(0, pace_h_per_s=0.0)


class Kernel:
    """System call results of macOS and Windows; ``uuid`` None: no such variable."""

    def __init__(self, uuid=None, counter=0):
        self.uuid, self.counter = uuid, counter

    def sysctl(self, name):
        if self.uuid is None or name != "kern.bootsessionuuid":
            raise OSError(name)
        return self.uuid

    def word_at(self, address):
        assert address == WINDOWS_BOOT_COUNTER == 0x7FFE02C4
        return self.counter

    def name(self, platform):
        return boot_name(platform, sysctl=self.sysctl, word_at=self.word_at)


def test_linux_names_its_boot_in_a_file(tmp_path):
    file = tmp_path / "boot_id"
    assert boot_name("linux", linux_file=file) is None
    file.write_text("3f1d\n", encoding="ascii")
    assert boot_name("linux", linux_file=file) == "3f1d"


@pytest.mark.parametrize(("platform", "field"), [("darwin", "uuid"), ("win32", "counter")])
def test_two_processes_agree_on_a_boot_and_two_boots_differ(platform, field):
    first, second = ("A-1", "A-2") if field == "uuid" else (7, 8)
    name = Kernel(**{field: first}).name(platform)  # type: ignore[arg-type] # one value for two fields
    assert name is not None
    assert str(first) in name
    assert name == Kernel(**{field: first}).name(platform)  # type: ignore[arg-type] # as above
    assert name != Kernel(**{field: second}).name(platform)  # type: ignore[arg-type] # as above


@pytest.mark.parametrize("platform", ["darwin", "win32"])
def test_a_kernel_without_a_boot_name_gives_no_boot(platform):
    assert Kernel().name(platform) is None


def test_the_frame_of_monotonic_times_stays_within_a_process():
    assert read_boot_id() == read_boot_id() != ""
