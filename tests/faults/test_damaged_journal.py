"""A journal that is damaged when a recorder starts: reported, set aside, and every sound shot is kept."""

from concurrent.futures import Future

import pytest
from support import crashed_recorders
from support.crashed_recorders import crash_settings, outcome, record
from support.memory_line import memory_settings

from daq_service.archive import FolderSetReader
from daq_service.archive.journal.frames import HEADER, Kind, parse_frames
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import AlarmRow, EventRow, SetRow
from daq_service.cli.maintenance.verify import verify_folder

SETS, SHOTS = 3, 3
A_SET = 3 * SHOTS + 1
"""Three transducers, and one pulse-echo record."""
KILLED_AFTER = A_SET + 5
"""Two echoes, then in the second set four shots."""


class Killed(BaseException):
    """End of the process."""


class NoWorker:
    """Worker that writes no file: sets stay in the journal."""

    def submit(self, *_):
        return Future()

    def shutdown(self, **_):
        pass


def short_settings():
    return memory_settings(
        schedule={"phases": [{"until_h": SETS * 0.5, "interval_h": 0.5}], "shots_per_set": SHOTS},
        clock={"kind": "wall"},
    )


def killed(folder, settings, after, **options):
    """Record until so many shots are acknowledged; return their ids."""
    shot_ids = []

    def acknowledged(shot_id):
        shot_ids.append(shot_id)
        if len(shot_ids) == after:
            raise Killed

    with pytest.raises(Killed):
        record(settings, folder, acknowledged=acknowledged, **options)
    return shot_ids


def newest_segment(folder):
    return max((folder / "journal").iterdir())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the result of the undamaged test."""
    folder = tmp_path_factory.mktemp("whole") / "test"
    record(short_settings(), folder)
    return outcome(folder, "wall")


def damage_alarms(folder):
    with open_catalogue(folder) as catalogue:
        events = [row.payload for row in catalogue.rows(EventRow) if row.kind == "data_corrupt"]
        return [row for row in catalogue.rows(AlarmRow) if row.kind == "data_corrupt"], events


def flip(place):
    def damage(content, found):
        content[place(found)] ^= 0x04

    return damage


def zeroed(content, found):
    """Overwrite a page of 512 bytes among the acknowledged records with zeros."""
    start = found[2].start + 100
    content[start : start + 512] = bytes(512)


PLACES = {
    "header of the first frame": flip(lambda found: found[0].start + 1),
    "facts of the first frame": flip(lambda found: found[0].start + HEADER.size + 3),
    "length in the header of a shot": flip(lambda found: found[2].start + 9),
    "checksum in the header of a shot": flip(lambda found: found[2].start + HEADER.size - 1),
    "facts of a shot": flip(lambda found: found[2].start + HEADER.size + 3),
    "counts of a shot": flip(lambda found: found[2].end - 9),
    "header of the last frame": flip(lambda found: found[-1].start + 20),
    "counts of the last frame": flip(lambda found: found[-1].end - 9),
    "a page of zeros": zeroed,
    "padding": flip(lambda found: found[-1].end + 1000),
}


QUICK = ("header of the first frame", "counts of a shot", "header of the last frame")


@pytest.mark.parametrize(
    "place", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in PLACES]
)
def test_corruption_in_an_open_set_is_reported_and_costs_only_its_shot(tmp_path, whole, place):
    folder, settings = tmp_path / "test", short_settings()
    shot_ids = killed(folder, settings, KILLED_AFTER)
    segment = newest_segment(folder)
    content = bytearray(segment.read_bytes())
    found = [frame for frame in parse_frames(bytes(content)) if frame.set_key == (1, 0)]
    assert found[0].kind is Kind.BEGIN
    PLACES[place](content, found)
    segment.write_bytes(content)
    sound = {frame.sequence for frame in parse_frames(bytes(content)) if frame.sound} | set(shot_ids[:A_SET])
    assert [line.kind for line in verify_folder(folder).damage].count("frame") >= 1

    record(settings, folder)
    (alarm,), events = damage_alarms(folder)
    assert (alarm.state, alarm.priority) == ("unacknowledged", "high")
    (copy,) = (folder / "quarantine").iterdir()
    assert copy.read_bytes() == bytes(content).rstrip(b"\0")
    assert [event["file"] for event in events] == [f"quarantine/{copy.name}"]
    after = outcome(folder, "wall")
    for shot_id in shot_ids:
        if shot_id in sound:
            assert after.keys[shot_id] == whole.keys[shot_id]
            assert after.counts[shot_id] == whole.counts[shot_id]
        else:
            assert shot_id not in after.keys, "an id is never used again"
    assert sorted(after.keys.values()) == sorted(whole.keys.values()), "what is lost is struck again"
    assert [(row.set_index, row.state, row.due_utc_ns) for row in after.rows["sets"]] == [
        (row.set_index, "done", row.due_utc_ns) for row in whole.rows["sets"]
    ]
    assert not record(settings, folder), "a second start strikes nothing"
    assert [path.name for path in (folder / "quarantine").iterdir()] == [copy.name]


def test_an_expired_set_names_the_corruption_as_its_cause(tmp_path, monkeypatch):
    folder, settings = tmp_path / "test", short_settings()
    killed(folder, settings, KILLED_AFTER)
    segment = newest_segment(folder)
    content = bytearray(segment.read_bytes())
    begin = next(frame for frame in parse_frames(bytes(content)) if frame.set_key == (1, 0))
    content[begin.start] ^= 1
    segment.write_bytes(content)

    def an_hour_later(before):
        return crashed_recorders.SimulatedClock(before.last_utc_ns + 3600 * 10**9)

    monkeypatch.setattr(crashed_recorders, "_clock_after", an_hour_later)
    record(settings, folder)
    with open_catalogue(folder) as catalogue:
        rows = catalogue.rows(SetRow, first_set=1, last_set=1)
    assert {row.position: (row.state, row.n_taken) for row in rows} == {
        "A": ("done", 1), "B": ("done", 3), "C": ("partial", 1), "D": ("missed", 0)
    }  # fmt: skip
    (cause,) = {row.reason for row in rows if row.reason}
    assert "journal was damaged" in cause


def test_a_segment_whose_name_is_damaged_is_found_by_its_frames(tmp_path):
    folder, settings = tmp_path / "test", short_settings()
    shot_ids = killed(folder, settings, KILLED_AFTER)
    segment = newest_segment(folder)
    segment.rename(segment.with_name(segment.name.replace("0", "p", 1)))
    assert [line.kind for line in verify_folder(folder).damage].count("frame") == 1
    record(settings, folder)
    assert set(shot_ids) <= outcome(folder, "wall").counts.keys()
    (alarm,), _ = damage_alarms(folder)
    assert alarm.state == "unacknowledged"


@pytest.mark.parametrize("kind", [pytest.param(Kind.BEGIN, marks=pytest.mark.slow), Kind.SHOT, Kind.END])
def test_corruption_in_a_set_with_rows_leaves_a_file_of_the_sound_records(tmp_path, kind):
    folder, settings = tmp_path / "test", short_settings()
    killed(folder, settings, KILLED_AFTER, worker=NoWorker)
    segment = newest_segment(folder)
    content = bytearray(segment.read_bytes())
    frame = next(
        frame for frame in parse_frames(bytes(content)) if (frame.set_key, frame.kind) == ((0, 0), kind)
    )
    content[frame.start + HEADER.size + 3] ^= 1
    segment.write_bytes(content)
    with open_catalogue(folder) as catalogue:
        before = {row.file for row in catalogue.rows(SetRow, first_set=0, last_set=0)} - {None}
    record(settings, folder)
    (alarm,), _ = damage_alarms(folder)
    assert alarm.state == "unacknowledged"
    (file,) = before
    assert (folder / file).exists()
    stored = FolderSetReader(folder).read_set(file)
    assert len(stored.records) == A_SET - (kind is Kind.SHOT)
    lost = [line.description for line in verify_folder(folder).damage]
    assert bool(lost) == (kind is Kind.SHOT), lost


def test_an_unscheduled_set_without_its_first_frame_goes_on(tmp_path):
    folder, settings = tmp_path / "test", crash_settings("wall")
    struck = 3 * crashed_recorders.SETS * crashed_recorders.SHOTS_PER_SET + crashed_recorders.SETS
    shot_ids = killed(folder, settings, struck + 2)
    segment = newest_segment(folder)
    content = bytearray(segment.read_bytes())
    begin = [frame for frame in parse_frames(bytes(content)) if frame.kind is Kind.BEGIN][-1]
    assert begin.set_key.unscheduled_index
    content[begin.start] ^= 1
    segment.write_bytes(content)
    record(settings, folder)
    after = outcome(folder, "wall")
    assert set(shot_ids) <= after.counts.keys()
    (row,) = [row for row in after.rows["sets"] if row.set_key == begin.set_key]
    assert (row.state, row.n_taken) == ("done", crashed_recorders.SHOTS_PER_SET)
    (alarm,), _ = damage_alarms(folder)
    assert alarm.state == "unacknowledged"
