"""What to play back is checked while it is read, with the key and the remedy."""

import math

import pytest
from pydantic import BaseModel, ValidationError

from hardware_drivers.playback.parameters import PlaybackParameters, TdmsMapping


class Rig(BaseModel):
    playback: PlaybackParameters


def test_a_table_of_a_file_becomes_parameters():
    table = {
        "source": "recordings",
        "format": "tdms",
        "tdms": {"rename": {"ai0": "B"}, "coefficients_v": [0, 1e-3], "pulse_echo_positions": ["A"]},
    }
    playback = Rig(playback=table).playback
    assert playback.tdms == TdmsMapping(
        rename={"ai0": "B"}, coefficients_v=(0.0, 1e-3), pulse_echo_positions=("A",)
    )
    assert Rig(playback={"source": "data"}).playback == PlaybackParameters(
        source=playback.source.parent / "data"
    )
    dumped = Rig(playback=table).model_dump(mode="json")
    assert Rig(**dumped).playback == playback


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"group_pattern": "("}, "group_pattern is '(', no regular expression"),
        ({"channel_pattern": "(?P<strike>.)"}, "the named group 'strike'; there are: position, set, shot"),
        ({"position": "B"}, "group_pattern and position both name the position; keep one"),
        ({"file_pattern": "(?P<position>.)"}, "file_pattern and group_pattern both name the position"),
        ({"shot_property": "n"}, "shot_property and channel_pattern both name the shot"),
        ({"group_pattern": ".*"}, "nothing names the position; give a pattern"),
        ({"appended": True}, "appended records are counted as shots; take"),
        ({"sample_rate_hz": 0.0}, "sample_rate_hz is 0.0; it must be greater than 0.0"),
        ({"sample_rate_hz": math.inf}, "sample_rate_hz is inf; it must be a finite number"),
        ({"record_samples": 0}, "record_samples is 0"),
        ({"range_v": -1.0}, "range_v is -1.0"),
        ({"resolution_bits": 33}, "resolution_bits is 33; it must be at most 32"),
        ({"pretrigger_samples": -1}, "pretrigger_samples is -1; it must be at least 0"),
        ({"volts_per_unit": 0.0}, "volts_per_unit is 0.0; it must be finite and not 0"),
        ({"coefficients_v": (1.0,)}, "coefficients_v is (1.0,); it needs two finite numbers"),
        ({"coefficients_v": (0.0, math.nan)}, "it needs two finite numbers"),
        ({"shot_interval_s": 0.0}, "shot_interval_s is 0.0; it must be greater than 0.0"),
        ({"averages": 0}, "averages is 0; it must be at least 1"),
    ],
)
def test_an_impossible_value_is_refused_with_key_and_value(values, message):
    with pytest.raises(ValueError, match=r".*") as refused:
        TdmsMapping(**values)
    assert message in str(refused.value)
    with pytest.raises(ValidationError):
        Rig(playback={"source": "x", "format": "tdms", "tdms": values})


def test_a_mapping_without_its_format_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r'format is "archive", yet \[tdms\] is given'):
        PlaybackParameters(source=tmp_path, tdms=TdmsMapping())


def test_an_unknown_key_is_refused():
    with pytest.raises(ValidationError, match="samplerate"):
        Rig(playback={"source": "x", "format": "tdms", "tdms": {"samplerate": 1e7}})
