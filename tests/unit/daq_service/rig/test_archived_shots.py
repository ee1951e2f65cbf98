"""A data folder as a recording: read set by set, with corruption, never written."""

from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from support.archived_sets import DUE_UTC_NS, SET_INDEX, assert_same_waveform, make_set, make_shot, other_set
from support.filed_archive import FiledArchive
from support.labview_files import write_set

from daq_service.archive import FolderSetReader
from daq_service.errors import UsageError
from daq_service.rig.playback import ArchivedShots, build_playback_instruments, open_recording
from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.measurement import ShotKey
from hardware_drivers.playback.parameters import PlaybackParameters
from simulator.clock import SimulatedClock

HOUR_NS = 3_600_000_000_000


def stored(folder, *sets):
    archive = FiledArchive(folder)
    for record in sets:
        archive.store_set(record)
    return sorted((folder / "sets").iterdir())


def test_every_record_is_found_to_the_last_bit(tmp_path):
    sets = [make_set(), other_set(make_set(), SET_INDEX + 1)]
    stored(tmp_path, *sets)
    source = ArchivedShots(FolderSetReader(tmp_path))
    assert source.positions == {
        "A": "pulse_echo",
        "B": "solitary_wave",
        "C": "solitary_wave",
        "D": "solitary_wave",
    }
    assert source.rig_kind == "simulated"
    assert source.configuration_hash == "ab" * 32
    assert source.epoch_utc_ns == DUE_UTC_NS - 4 * HOUR_NS
    for record in [item for one in sets for item in one.records]:
        found = source.find(record.key)
        assert_same_waveform(found.waveform, record.waveform)
        assert found.truth == record.truth
        assert found.settings == record.settings
    assert source.find(ShotKey(position="B", set_index=SET_INDEX, shot_index=0, attempt=1)) is None
    assert source.find(ShotKey(position="B", set_index=SET_INDEX + 5, shot_index=0)) is None


def hours_later(record, hours):
    """Return the records of a set at a later time."""

    def moved(item):
        stamp = replace(item.stamp, utc_ns=item.stamp.utc_ns + hours * HOUR_NS)
        return replace(item, stamp=stamp, truth=dict(item.truth), settings=dict(item.settings))

    return replace(
        record,
        started_utc_ns=record.started_utc_ns + hours * HOUR_NS,
        ended_utc_ns=record.ended_utc_ns + hours * HOUR_NS,
        shots=[moved(shot) for shot in record.shots],
        echoes=[moved(echo) for echo in record.echoes],
    )


def test_moments_are_the_starts_and_stamps_in_order(tmp_path):
    # A set starts before its first record.
    first = replace(make_set(), started_utc_ns=DUE_UTC_NS - 7)
    # Set 8 was not recorded; it is asked for past its time too.
    later = hours_later(other_set(first, SET_INDEX + 2), 2)
    stored(tmp_path, first, later)
    source = ArchivedShots(FolderSetReader(tmp_path))
    wanted = sorted(
        {item.started_utc_ns for item in (first, later)}
        | {record.stamp.utc_ns for item in (first, later) for record in item.records}
    )
    found, moment = [], source.find_next_moment(0)
    while moment is not None:
        found.append(moment)
        moment = source.find_next_moment(moment)
    assert found == wanted
    # A new read from the middle needs nothing before it.
    again = ArchivedShots(FolderSetReader(tmp_path))
    assert again.find_next_moment(first.due_utc_ns + HOUR_NS) == later.started_utc_ns


def test_a_position_that_was_disabled_at_first_is_known_from_the_configuration(tmp_path):
    configured = {
        "configuration": {"positions": {"B": {"method": "solitary_wave"}, "E": {"method": "pulse_echo"}}}
    }
    stored(tmp_path, replace(make_set(), provenance=configured))
    assert ArchivedShots(FolderSetReader(tmp_path)).positions["E"] == "pulse_echo"


def test_a_corrupt_file_costs_only_its_set(tmp_path):
    first, second = stored(tmp_path, make_set(), other_set(make_set(), SET_INDEX + 1))
    first.write_bytes(b"no HDF5 at all")
    source = ArchivedShots(FolderSetReader(tmp_path))
    key = ShotKey(position="B", set_index=SET_INDEX, shot_index=0)
    with pytest.raises(AcquisitionTimeoutError, match="is damaged"):
        source.find(key)
    assert source.find(replace(key, set_index=SET_INDEX + 1)) is not None
    second.write_bytes(b"nor this")
    with pytest.raises(UsageError, match=r"none of the 2 sets of .* can be read"):
        ArchivedShots(FolderSetReader(tmp_path))


def test_a_file_that_vanished_is_a_fault_of_the_recording(tmp_path):
    first, second = stored(tmp_path, make_set(), other_set(make_set(), SET_INDEX + 1))
    source = ArchivedShots(FolderSetReader(tmp_path))
    assert first.exists()
    second.unlink()
    with pytest.raises(ConfigurationError, match="the recording cannot be read: there is no file"):
        source.find(ShotKey(position="B", set_index=SET_INDEX + 1, shot_index=0))


def test_a_folder_without_sets_is_refused(tmp_path):
    with (
        pytest.raises(UsageError, match="holds no sets; give the data folder of a test"),
        open_recording(PlaybackParameters(source=tmp_path / "nowhere"), tmp_path),
    ):
        raise AssertionError("opened")


def test_a_corrupt_record_is_a_missed_strike_and_its_set_knows_no_others(tmp_path):
    first, _ = stored(tmp_path, make_set(), other_set(make_set(), SET_INDEX + 1))
    key = ShotKey(position="D", set_index=SET_INDEX + 1, shot_index=0, attempt=1)
    source = ArchivedShots(FolderSetReader(tmp_path))
    assert source.has_attempt(key)
    assert source.has_attempt(replace(key, position="B", shot_index=1))
    assert not source.has_attempt(replace(key, shot_index=1))
    image = bytearray(first.read_bytes())
    with h5py.File(first) as file:
        image[file["entry/B_waveforms/waveform"].id.get_chunk_info(0).byte_offset + 40] ^= 0x10
    first.write_bytes(image)
    source = ArchivedShots(FolderSetReader(tmp_path))
    assert not source.has_attempt(replace(key, set_index=SET_INDEX))
    corrupt = ShotKey(position="B", set_index=SET_INDEX, shot_index=0)
    assert source.find(replace(corrupt, position="C")) is not None
    with pytest.raises(
        AcquisitionTimeoutError, match=r"shot 0 of set 7 at 'B' cannot be .*\.h5: shot 0 of B"
    ):
        source.find(corrupt)
    assert source.has_attempt(ShotKey(position="B", set_index=SET_INDEX, shot_index=1, attempt=1))


def test_a_relative_source_counts_from_the_configuration(tmp_path):
    stored(tmp_path / "old", make_set())
    with open_recording(PlaybackParameters(source="old"), tmp_path) as source:
        assert "B" in source.positions


def test_faults_of_labview_files_are_usage_errors_and_files_are_closed(tmp_path):
    parameters = PlaybackParameters(source=tmp_path, format="tdms")
    with (
        pytest.raises(UsageError, match=r"cannot be played back: .* has no file"),
        open_recording(parameters, tmp_path),
    ):
        raise AssertionError("opened")
    shot = make_shot("B", 0, 1)
    path = write_set(tmp_path, SET_INDEX, [shot])
    with open_recording(parameters, tmp_path) as source:
        assert source.find(shot.key).waveform.counts.tobytes() == shot.waveform.counts.tobytes()
    # Only Linux shows it; on Windows the removal of an open file fails.
    still_open = [entry.readlink() for entry in Path("/proc/self/fd").glob("[0-9]*") if entry.is_symlink()]
    assert path not in still_open
    path.unlink()


def test_a_rig_refuses_positions_that_were_not_recorded(tmp_path):
    stored(tmp_path, make_set())
    with open_recording(PlaybackParameters(source=tmp_path), tmp_path) as source:

        def rig(wanted, *, recorded_times=False):
            return build_playback_instruments(
                source,
                SimulatedClock(source.epoch_utc_ns),
                wanted=wanted,
                identity={"recording": "here"},
                recorded_times=recorded_times,
                shot_interval_s=4.0,
            )

        with pytest.raises(UsageError, match=r"does not fit the configuration: .*position 'E'"):
            rig({"E": "solitary_wave"})
        opened_rig = rig({"B": "solitary_wave", "A": "pulse_echo"}, recorded_times=True)
        assert opened_rig.identity == {"recording": "here"}
        # The second shot of B was recorded 1 ns past its planned time.
        opened_rig.clock.wait_until(DUE_UTC_NS + 4_000_000_000, lambda: True)
        assert opened_rig.clock.utc_ns() == DUE_UTC_NS + 4_000_000_001
