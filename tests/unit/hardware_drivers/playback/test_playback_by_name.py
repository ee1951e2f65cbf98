"""LabVIEW files with all channels in one group are played by the channels' names, without a pattern."""

import pytest
from support.archived_sets import make_shot
from support.labview_files import raw_properties, write

from daq_service.rig.playback import open_recording
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Echo
from hardware_drivers.measurement import ShotKey
from hardware_drivers.playback.parameters import PlaybackParameters, TdmsMapping
from hardware_drivers.playback.tdms import open_tdms

SHOT = make_shot("B", 3, 43)
WANTED = {"B": "solitary_wave", "C": "solitary_wave", "A": "pulse_echo"}


def recording(path, *names, group="Measured Data"):
    """Each channel's first code is its number, so that a test sees which one it got."""
    channels = []
    for number, name in enumerate(names):
        counts = SHOT.waveform.counts.copy()
        counts[0] = number
        # A probe's record starts at the firing pulse.
        start = {"wf_start_offset": 0.0} if name == "A" else {}
        channels.append((group, name, counts, {**raw_properties(SHOT.waveform), **start}))
    return write(path, channels)


def found(source, wanted=WANTED, **mapping):
    """Number of the channel behind each shot."""
    with open_tdms(source, TdmsMapping(**mapping) if mapping else None, positions=wanted) as shots:
        return {
            (key.position, key.set_index, key.shot_index): int(shots.find(key).waveform.counts[0])
            for key in shots.places
        }


def test_a_channel_named_after_its_position_is_its_shot(tmp_path):
    path = recording(tmp_path / "March 3.tdms", "B", "C", "Temperature")
    assert found(path) == {("B", 0, 0): 0, ("C", 0, 0): 1}


@pytest.mark.parametrize("pattern", ["B_{}", "B{}", "B shot {}", "B.Shot_{}", "B-{}"])
def test_a_number_after_the_position_is_the_shot_index(tmp_path, pattern):
    path = recording(tmp_path / "x.tdms", *(pattern.format(number) for number in (2, 10)))
    assert found(path) == {("B", 0, 2): 0, ("B", 0, 10): 1}


def test_names_of_the_wiring_are_renamed_first(tmp_path):
    path = recording(tmp_path / "x.tdms", "ai0", "ai1")
    assert found(path, rename={"ai0": "B", "ai1": "C"}) == {("B", 0, 0): 0, ("C", 0, 0): 1}


def test_files_of_sets_count_as_ever_and_a_probe_s_channel_gives_echoes(tmp_path):
    for index in (0, 1):
        recording(tmp_path / f"set_{index}.tdms", "B", "C", "A")
    with open_recording(PlaybackParameters(source=tmp_path, format="tdms"), tmp_path, WANTED) as shots:
        assert shots.positions == {"B": "solitary_wave", "C": "solitary_wave", "A": "pulse_echo"}
        assert isinstance(shots.find(ShotKey(position="A", set_index=1, shot_index=0)), Echo)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["B", "B_0"], "channels 'B' and 'B_0' are both shot 0 of 'B'"),
        (["B1", "B 1", "C"], "channels 'B1' and 'B 1' are both shot 1 of 'B'"),
    ],
)
def test_two_names_for_one_shot_are_refused_with_the_names_found(tmp_path, names, message):
    path = recording(tmp_path / "x.tdms", *names)
    with pytest.raises(ConfigurationError) as refusal:
        found(path)
    assert message in str(refusal.value)
    assert f"its channels are: {', '.join(sorted(names))}; assign it by" in str(refusal.value)


def test_a_name_for_two_positions_is_refused(tmp_path):
    path = recording(tmp_path / "x.tdms", "B12")
    wanted = {"B": "solitary_wave", "B1": "solitary_wave"}
    with pytest.raises(ConfigurationError, match="'B12' is shot 12 of 'B', or of 'B1'; its channels are"):
        found(path, wanted)


def test_the_name_of_a_position_is_not_matched_as_a_shot_of_another(tmp_path):
    path = recording(tmp_path / "x.tdms", "B1", "B")
    assert found(path, {"B": "solitary_wave", "B1": "solitary_wave"}) == {("B", 0, 0): 1, ("B1", 0, 0): 0}


def test_names_of_no_position_are_shown(tmp_path):
    path = recording(tmp_path / "x.tdms", "Untitled", "Untitled 1")
    match = r"one group with channels named after B, C, A; .*x.tdms/Measured Data/Untitled, "
    with pytest.raises(ConfigurationError, match=match):
        found(path)


def test_several_groups_and_any_pattern_are_played_as_ever(tmp_path):
    write(
        tmp_path / "set_0.tdms",
        [(group, "B", SHOT.waveform.counts, raw_properties(SHOT.waveform)) for group in ("one", "two")],
    )
    with pytest.raises(ConfigurationError, match="has no record that matches"):
        found(tmp_path)
    recording(tmp_path / "set_0.tdms", "B", group="B")
    with pytest.raises(ConfigurationError, match="has no record that matches"):
        found(tmp_path, channel_pattern=r"Strike (?P<shot>\d+)")
