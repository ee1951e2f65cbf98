"""What LabVIEW files say becomes shots exactly, and what they do not say is asked for."""

import builtins
import struct
from dataclasses import replace

import numpy as np
import pytest
from support.archived_sets import CURVED, assert_same_waveform, counts_of, make_shot
from support.labview_files import polynomial, raw_properties, waveform_properties, write, write_set

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Acquired, Echo
from hardware_drivers.measurement import ShotKey
from hardware_drivers.playback.parameters import TdmsMapping
from hardware_drivers.playback.tdms import open_tdms

KEY = ShotKey(position="B", set_index=7, shot_index=3)
SHOT = make_shot("B", 3, 43)
RAW = raw_properties(SHOT.waveform, SHOT.stamp.utc_ns)
VOLTS = waveform_properties(SHOT.waveform, SHOT.stamp.utc_ns)


def without(properties, *names):
    return {name: value for name, value in properties.items() if name not in names}


def one_channel(folder, values, properties, *, group="B", name="shot_3", file="set_7.tdms"):
    return write(folder / file, [(group, name, values, properties)])


def played(folder, key=KEY, **mapping):
    with open_tdms(folder, TdmsMapping(**mapping)) as shots:
        return shots.find(key)


# Codes --------------------------------------------------------------------------------------------


def test_codes_and_their_polynomial_pass_to_the_last_bit(tmp_path):
    write_set(tmp_path, 7, [SHOT])
    found = played(tmp_path)
    assert type(found) is Acquired
    assert_same_waveform(found.waveform, replace_range(SHOT.waveform))
    assert found.settings == {"tdms_channel": "set_000007.tdms/B/shot_3"}
    assert found.truth == {}


def replace_range(waveform):
    """The file contains neither range nor date: the range is what the extreme codes mean."""
    calibration = waveform.calibration
    _, high = calibration.full_scale_counts
    constant, slope = calibration.coefficients_v
    return replace(
        waveform, calibration=replace(calibration, range_v=float(constant + high * slope), date="")
    )


def test_32_bit_codes_need_the_converter_s_resolution(tmp_path):
    shot = make_shot("B", 3, 43, dtype=np.int32, calibration=CURVED)
    write_set(tmp_path, 7, [shot])
    with pytest.raises(ConfigurationError, match=r"'B', channel 'shot_3'.*give resolution_bits"):
        open_tdms(tmp_path)
    found = played(tmp_path, resolution_bits=24, range_v=5.0)
    assert_same_waveform(found.waveform, shot.waveform)


def test_the_codes_of_a_12_bit_board_clip_at_2047(tmp_path):
    counts = SHOT.waveform.counts.copy()
    counts[5] = 2047
    one_channel(tmp_path, counts, RAW)
    assert not played(tmp_path).waveform.clipped
    assert played(tmp_path, resolution_bits=12).waveform.clipped
    with pytest.raises(ConfigurationError, match="resolution_bits is 18, yet the codes have 16"):
        played(tmp_path, resolution_bits=18)


def test_8_bit_codes_become_16_bit_ones(tmp_path):
    counts = np.arange(-128, 127, dtype=np.int8)
    one_channel(tmp_path, counts, without(RAW, "wf_samples"))
    waveform = played(tmp_path, pretrigger_samples=10).waveform
    assert waveform.counts.dtype == np.int16
    assert waveform.counts.tolist() == counts.tolist()
    assert waveform.calibration.resolution_bits == 8


def test_big_endian_codes_keep_their_size(tmp_path):
    """Written by hand: npTDMS writes little-endian files only."""
    counts = np.array([100_000, -100_000, 7, 8], dtype=">i4")

    def text(value):
        return struct.pack(">L", len(value)) + value.encode()

    meta = struct.pack(">L", 1) + text("/'B'/'shot_3'")
    meta += struct.pack(">LLLQL", 20, 3, 1, counts.size, 0)
    raw = counts.tobytes()
    lead_in = b"TDSm" + struct.pack("<L", 0x2 | 0x4 | 0x8 | 0x40)
    lead_in += struct.pack(">LQQ", 4713, len(meta) + len(raw), len(meta))
    (tmp_path / "set_7.tdms").write_bytes(lead_in + meta + raw)
    mapping = {
        "coefficients_v": (0.0, 1e-5),
        "sample_rate_hz": 1e7,
        "pretrigger_samples": 1,
        "resolution_bits": 18,
    }
    found = played(tmp_path, **mapping)
    assert found.waveform.counts.dtype == np.dtype(np.int32)
    assert found.waveform.counts.tolist() == counts.tolist()


def daqmx_raw_file(path, counts, scalers, properties):
    """Codes as DAQmx logs them: a "format changing scaler" states their type; npTDMS cannot write this."""

    def text(value):
        return struct.pack("<L", len(value)) + value.encode()

    # Header of the index, type of DAQmx raw data, dimension, rows.
    index = struct.pack("<LLLQ", 0x1269, 0xFFFFFFFF, 1, len(counts))
    index += struct.pack("<L", len(scalers))
    for scale_id, offset in scalers:
        # Type 3 is int16: buffer, byte offset in a row, sample format.
        index += struct.pack("<LLLLL", 3, 0, offset, 0, scale_id)
    index += struct.pack("<LL", 1, 2 * len(scalers))
    meta = struct.pack("<L", 1) + text("/'B'/'shot_3'") + index
    encoded = b"".join(text(name) + struct.pack("<Ld", 10, value) for name, value in properties.items())
    meta += struct.pack("<L", len(properties)) + encoded
    rows = np.repeat(counts[:, None], len(scalers), axis=1).astype("<i2").tobytes()
    lead_in = b"TDSm" + struct.pack("<LLQQ", 0x8E, 4713, len(meta) + len(rows), len(meta))
    path.write_bytes(lead_in + meta + rows)


def test_codes_that_daqmx_logged_are_codes(tmp_path):
    properties = {"wf_increment": 1e-7, "wf_start_offset": -1e-6}
    counts = counts_of(1, 300)
    daqmx_raw_file(tmp_path / "set_7.tdms", counts, [(0, 0)], properties)
    waveform = played(tmp_path, coefficients_v=(0.0, 1e-3)).waveform
    assert waveform.counts.dtype == np.int16
    assert waveform.counts.tobytes() == counts.tobytes()
    assert waveform.pretrigger_samples == 10


def test_a_channel_of_two_daqmx_scalers_is_refused(tmp_path):
    daqmx_raw_file(tmp_path / "set_7.tdms", counts_of(1, 300), [(0, 0), (1, 2)], {"wf_increment": 1e-7})
    with pytest.raises(ConfigurationError, match=r"'B'/'shot_3' has 2 DAQmx scalers"):
        open_tdms(tmp_path, TdmsMapping(coefficients_v=(0.0, 1e-3)))


TABLE = {"NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Table"}
BY_PROPERTY = {"channel_pattern": ".*", "shot_property": "Shot"}


@pytest.mark.parametrize(
    ("properties", "mapping", "message"),
    [
        (VOLTS | TABLE, {}, r"scale 0 is of type 'Table'.*give coefficients_v"),
        *((RAW | {"wf_increment": value}, {}, r"shot_3.*wf_increment is") for value in (0.0, -1e-7, "fast")),
        (RAW | {"wf_increment": float("nan")}, {}, r"shot_3.*wf_increment is"),
        (
            RAW | {"wf_start_offset": -300e-7},
            {},
            "trigger at sample 300 is outside the record of 300 samples",
        ),
        (RAW | {"wf_start_time": "noon"}, {}, "wf_start_time is 'noon', no time stamp"),
        (RAW | {"wf_samples": 301}, {}, r"'shot_3': cut short, 300 of 301 samples \(wf_samples\)"),
        (RAW, {"first_shot": 4}, "shot has the number 3; whole numbers count from 4; correct first_shot"),
        (RAW | {"Shot": "three"}, BY_PROPERTY, "the shot .*three"),
        (RAW | {"Shot": "3.5"}, BY_PROPERTY, r"the shot .*3\.5"),
        (RAW | {"Shot": 2.5}, BY_PROPERTY, r"the shot .*2\.5"),
        (RAW | {"Shot": -1}, BY_PROPERTY, "the shot .*-1"),
    ],
)
def test_an_impossible_property_is_refused(tmp_path, properties, mapping, message):
    one_channel(tmp_path, SHOT.waveform.counts, properties)
    with pytest.raises(ConfigurationError, match=message):
        open_tdms(tmp_path, TdmsMapping(**mapping))


def test_unsigned_codes_are_refused(tmp_path):
    one_channel(tmp_path, np.arange(300, dtype=np.uint16), RAW)
    with pytest.raises(ConfigurationError, match=r"type uint16.*write I16, I32, SGL or DBL"):
        open_tdms(tmp_path)


def test_codes_without_a_scaling_need_the_board_s_polynomial(tmp_path):
    one_channel(tmp_path, SHOT.waveform.counts, VOLTS)
    with pytest.raises(ConfigurationError, match="whole numbers without NI scaling; give coefficients_v"):
        open_tdms(tmp_path)
    found = played(tmp_path, coefficients_v=(0.5, 1e-3, 1e-9))
    assert found.waveform.calibration.coefficients_v.tolist() == [0.5, 1e-3, 1e-9]


@pytest.mark.parametrize("place", ["group", "file"])
def test_a_scaling_may_belong_to_the_group_or_the_file(tmp_path, place):
    scaling = {name: value for name, value in RAW.items() if name.startswith("NI_")}
    write(
        tmp_path / "set_7.tdms",
        [("B", "shot_3", SHOT.waveform.counts, VOLTS)],
        groups={"B": scaling} if place == "group" else {},
        root=scaling if place == "file" else {},
    )
    found = played(tmp_path)
    assert (
        found.waveform.calibration.coefficients_v.tolist()
        == SHOT.waveform.calibration.coefficients_v.tolist()
    )


# Scaled values --------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("range_v", [None, 5.0, 0.3])
def test_scaled_values_become_codes_off_by_less_than_1e_9_of_the_range(tmp_path, dtype, range_v):
    full_v = 10.0 if range_v is None else range_v
    volts = np.random.default_rng(1).uniform(-full_v, full_v, 300).astype(dtype)
    volts = np.clip(volts, np.nextafter(-dtype(full_v), dtype(0)), np.nextafter(dtype(full_v), dtype(0)))
    one_channel(tmp_path, volts, VOLTS)
    found = played(tmp_path, range_v=range_v)
    waveform = found.waveform
    assert waveform.counts.dtype == np.int32
    error_v = np.abs(waveform.volts() - volts.astype(np.float64)).max()
    assert error_v < 1e-9 * full_v
    # Half a code, and the rounding of the polynomial: nothing is rounded to one side.
    assert error_v <= 0.5001 * full_v / 2**31
    assert waveform.calibration.range_v == full_v
    assert found.settings["quantised_from"] == np.dtype(dtype).name
    assert found.settings["quantisation_step_v"] == waveform.calibration.coefficients_v[1] == full_v / 2**31


def test_every_record_of_scaled_values_has_one_calibration(tmp_path):
    loud, quiet = np.full(300, 3.0), np.full(300, 1e-3)
    write(tmp_path / "set_7.tdms", [("B", "shot_3", loud, VOLTS), ("B", "shot_4", quiet, VOLTS)])
    with open_tdms(tmp_path) as shots:
        first, second = (shots.find(replace(KEY, shot_index=index)) for index in (3, 4))
    assert first.waveform.calibration is second.waveform.calibration


@pytest.mark.parametrize("extreme_v", [10.0, -10.0])
def test_the_range_itself_counts_as_clipped_and_is_within_the_error(tmp_path, extreme_v):
    volts = np.linspace(-1.0, 1.0, 300)
    one_channel(tmp_path, volts, VOLTS)
    assert not played(tmp_path).waveform.clipped
    volts[7] = extreme_v
    one_channel(tmp_path, volts, VOLTS)
    waveform = played(tmp_path).waveform
    assert waveform.clipped
    assert abs(waveform.volts()[7] - extreme_v) < 1e-9 * 10.0


@pytest.mark.parametrize(
    ("value", "message"),
    [(10.001, r"10\.001 V exceeds the range of 10 V; raise range_v"), (np.nan, "a value is not finite")],
)
def test_values_that_no_code_can_hold_are_refused_when_asked_for(tmp_path, value, message):
    volts = np.zeros(300)
    volts[9] = value
    one_channel(tmp_path, volts, VOLTS)
    with open_tdms(tmp_path) as shots, pytest.raises(ConfigurationError, match=f"'shot_3': .*{message}"):
        shots.find(KEY)


def test_unscaled_floats_are_scaled_first(tmp_path):
    scaling = {"NI_Number_Of_Scales": 1, "NI_Scaling_Status": "unscaled"} | polynomial([0.5, 2.0, 0.0, 0.25])
    x = np.linspace(-1.0, 1.0, 300)
    one_channel(tmp_path, x, VOLTS | scaling)
    found = played(tmp_path)
    assert np.abs(found.waveform.volts() - (0.5 + 2.0 * x + 0.25 * x**3)).max() < 1e-8


def test_floats_that_were_scaled_are_not_scaled_again(tmp_path):
    scaling = {"NI_Number_Of_Scales": 1, "NI_Scaling_Status": "scaled"} | polynomial([0.5, 2.0])
    x = np.linspace(-1.0, 1.0, 300)
    one_channel(tmp_path, x, VOLTS | scaling)
    # 1e-9 of the range of 10 V.
    assert np.abs(played(tmp_path).waveform.volts() - x).max() < 1e-8


# Units, rate, trigger, time --------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "message"), [("Pa", "the unit is 'Pa', V is needed"), (None, "no unit")])
@pytest.mark.parametrize("kind", ["codes", "scaled"])
def test_a_unit_other_than_volts_needs_a_scale(tmp_path, unit, message, kind):
    properties = without(RAW if kind == "codes" else VOLTS, "unit_string")
    values = SHOT.waveform.counts if kind == "codes" else SHOT.waveform.volts()
    one_channel(tmp_path, values, properties if unit is None else properties | {"unit_string": unit})
    with pytest.raises(ConfigurationError, match=rf"set_7.tdms, group 'B'.*{message}.*give volts_per_unit"):
        open_tdms(tmp_path)
    found = played(tmp_path, volts_per_unit=1e-3)
    assert np.abs(found.waveform.volts() - 1e-3 * SHOT.waveform.volts()).max() < 1e-8


@pytest.mark.parametrize("unit", ["V", "Volts", "volt", " V "])
def test_volts_have_many_names_and_are_never_scaled(tmp_path, unit):
    one_channel(tmp_path, SHOT.waveform.counts, RAW | {"unit_string": unit})
    coefficients = played(tmp_path, volts_per_unit=1e-3).waveform.calibration.coefficients_v
    assert coefficients.tolist() == SHOT.waveform.calibration.coefficients_v.tolist()


def test_a_missing_rate_is_requested(tmp_path):
    one_channel(tmp_path, SHOT.waveform.counts, without(RAW, "wf_increment"))
    with pytest.raises(
        ConfigurationError, match=r"no sample rate \(wf_increment is missing\); give sample_rate"
    ):
        open_tdms(tmp_path)
    assert played(tmp_path, sample_rate_hz=2.5e6, pretrigger_samples=4).waveform.sample_rate_hz == 2.5e6


@pytest.mark.parametrize("rate_hz", [10e6, 3e6, 100e6, 49.0, 98.0])
def test_whole_rates_survive_their_reciprocal(tmp_path, rate_hz):
    one_channel(tmp_path, SHOT.waveform.counts, RAW | {"wf_increment": 1.0 / rate_hz})
    assert played(tmp_path, pretrigger_samples=4).waveform.sample_rate_hz == rate_hz


@pytest.mark.parametrize("offset", [None, 0.0, 1e-5])
def test_a_missing_trigger_position_is_requested(tmp_path, offset):
    offsets = {} if offset is None else {"wf_start_offset": offset}
    one_channel(tmp_path, SHOT.waveform.counts, without(RAW, "wf_start_offset") | offsets)
    with pytest.raises(
        ConfigurationError, match=r"the position of the trigger is unknown.*give pretrigger_samples"
    ):
        open_tdms(tmp_path)
    assert played(tmp_path, pretrigger_samples=0).waveform.pretrigger_samples == 0


def test_channel_properties_override_group_properties_and_those_the_file(tmp_path):
    write(
        tmp_path / "set_7.tdms",
        [("B", "shot_3", SHOT.waveform.counts, without(RAW, "wf_start_offset"))],
        groups={"B": {"wf_increment": 1e-3, "wf_start_offset": -30e-7}},
        root={"wf_start_offset": -70e-7},
    )
    waveform = played(tmp_path).waveform
    assert (waveform.sample_rate_hz, waveform.pretrigger_samples) == (1e7, 30)


def test_the_mapping_s_trigger_wins(tmp_path):
    write_set(tmp_path, 7, [SHOT])
    assert played(tmp_path, pretrigger_samples=17).waveform.pretrigger_samples == 17


def test_times_are_exact_to_the_nanosecond(tmp_path):
    shots = [make_shot("B", index, 40 + index) for index in range(3)]
    write_set(tmp_path, 7, shots)
    with open_tdms(tmp_path) as recording:
        assert [recording.places[shot.key].utc_ns for shot in shots] == [shot.stamp.utc_ns for shot in shots]
        moments = [shot.stamp.utc_ns for shot in shots]
        assert recording.find_next_moment(0) == moments[0]
        assert recording.find_next_moment(moments[0]) == moments[1]
        assert recording.find_next_moment(moments[2]) is None


def test_a_record_without_a_time_has_none(tmp_path):
    one_channel(tmp_path, SHOT.waveform.counts, without(RAW, "wf_start_time"))
    with open_tdms(tmp_path) as shots:
        assert shots.places[KEY].utc_ns is None
        assert shots.find_next_moment(0) is None


# Which shot a record is ---------------------------------------------------------------------------


def test_names_may_count_from_1_and_positions_have_other_names(tmp_path):
    one_channel(
        tmp_path, SHOT.waveform.counts, RAW, group="Set 8", name="ai0 strike 4", file="2024/March.tdms"
    )
    found = played(
        tmp_path,
        file_pattern=".*",
        group_pattern=r"Set (?P<set>\d+)",
        channel_pattern=r"(?P<position>ai\d) strike (?P<shot>\d+)",
        rename={"ai0": "B"},
        first_set=1,
        first_shot=1,
    )
    assert_same_waveform(found.waveform, replace_range(SHOT.waveform))


def test_properties_may_supply_all_settings(tmp_path):
    properties = RAW | {"Shot number": 4}
    write(
        tmp_path / "data.tdms",
        [("Untitled", "Voltage", SHOT.waveform.counts, properties)],
        groups={"Untitled": {"Channel": "B"}},
        root={"Set": "7"},
    )
    patterns = {"file_pattern": ".*", "group_pattern": ".*", "channel_pattern": ".*"}
    mapping = {"position_property": "Channel", "set_property": "Set", "shot_property": "Shot number"}
    with open_tdms(tmp_path / "data.tdms", TdmsMapping(**patterns, **mapping, first_shot=1)) as shots:
        assert list(shots.places) == [KEY]
        assert shots.positions == {"B": "solitary_wave"}
    with pytest.raises(ConfigurationError, match="property 'Sets' that gives the set is missing"):
        open_tdms(tmp_path, TdmsMapping(**patterns, **mapping | {"set_property": "Sets"}))


def test_a_record_without_a_position_is_refused(tmp_path):
    one_channel(tmp_path, SHOT.waveform.counts, RAW, group="Untitled")
    with pytest.raises(ConfigurationError, match="nothing names the position; correct the patterns"):
        open_tdms(tmp_path, TdmsMapping(group_pattern="(?P<position>[A-D])?Untitled"))


def test_attempts_may_be_named(tmp_path):
    other = make_shot("B", 3, 99, attempt=1)
    write(
        tmp_path / "set_7.tdms",
        [
            ("B", "shot_3", SHOT.waveform.counts, RAW),
            ("B", "shot_3 again 1", other.waveform.counts, raw_properties(other.waveform)),
        ],
    )
    with open_tdms(
        tmp_path, TdmsMapping(channel_pattern=r"shot_(?P<shot>\d+)(?: again (?P<attempt>\d+))?")
    ) as s:
        assert s.find(other.key).waveform.counts.tobytes() == other.waveform.counts.tobytes()
        assert s.find(KEY).waveform.counts.tobytes() == SHOT.waveform.counts.tobytes()


def test_appended_records_are_shots_of_one_channel(tmp_path):
    counts = counts_of(5, 900)
    one_channel(tmp_path, counts, RAW, name="Voltage")
    mapping = {"channel_pattern": "Voltage", "appended": True, "shot_interval_s": 4.0}
    with open_tdms(tmp_path, TdmsMapping(**mapping)) as shots:
        assert [key.shot_index for key in shots.places] == [0, 1, 2]
        for number in (2, 0, 1):
            found = shots.find(replace(KEY, shot_index=number))
            assert found.waveform.counts.tolist() == counts[300 * number : 300 * (number + 1)].tolist()
            assert (
                shots.places[replace(KEY, shot_index=number)].utc_ns
                == SHOT.stamp.utc_ns + number * 4_000_000_000
            )
    with pytest.raises(
        ConfigurationError,
        match="900 samples are not a whole number of records of 400; correct record_samples",
    ):
        open_tdms(tmp_path, TdmsMapping(**mapping, record_samples=400))
    one_channel(tmp_path, counts, without(RAW, "wf_samples"), name="Voltage")
    with pytest.raises(ConfigurationError, match=r"length of a record is unknown.*give record_samples"):
        open_tdms(tmp_path, TdmsMapping(**mapping))


def test_a_channel_written_in_pieces_is_one_record(tmp_path):
    """LabVIEW streams a long record in several writes; wf_samples is then one write's."""
    from nptdms import ChannelObject, TdmsWriter

    counts = SHOT.waveform.counts
    with TdmsWriter(tmp_path / "set_7.tdms") as writer:
        for piece in np.split(counts, 3):
            writer.write_segment([ChannelObject("B", "shot_3", piece, RAW | {"wf_samples": 100})])
    assert played(tmp_path).waveform.counts.tobytes() == counts.tobytes()


def test_two_records_of_one_shot_are_refused_with_both_places(tmp_path):
    one_channel(tmp_path, SHOT.waveform.counts, RAW, file="a_set_7.tdms")
    one_channel(tmp_path, SHOT.waveform.counts, RAW, file="b_set_7.tdms")
    with pytest.raises(
        ConfigurationError, match=r"b_set_7.tdms.* and .*a_set_7.tdms.* are both shot 3 of set 7"
    ):
        open_tdms(tmp_path)


def test_unmatched_files_are_skipped_and_no_match_is_an_error_with_the_names(tmp_path):
    channels = [("B", "shot_3", SHOT.waveform.counts, RAW), ("Log", "room temperature", [21.5, 22.0], {})]
    write(tmp_path / "set_7.tdms", channels)
    (tmp_path / "notes.tdms").write_text("not looked into: its name does not match")
    with open_tdms(tmp_path) as shots:
        assert list(shots.places) == [KEY]
    with pytest.raises(
        ConfigurationError, match=r"correct the patterns; names found: .*set_7.tdms/Log/room temp"
    ):
        open_tdms(tmp_path, TdmsMapping(channel_pattern="strike_(?P<shot>[0-9]+)"))


def test_an_empty_channel_was_not_recorded(tmp_path):
    channels = [
        ("B", "shot_2", np.zeros(0, np.int16), {}),
        ("B", "shot_3", SHOT.waveform.counts, RAW),
    ]
    write(tmp_path / "set_7.tdms", channels)
    with open_tdms(tmp_path) as shots:
        assert list(shots.places) == [KEY]
        assert shots.find(replace(KEY, shot_index=2)) is None


def test_a_missing_folder_and_missing_files_are_reported(tmp_path):
    with pytest.raises(ConfigurationError, match="there is no TDMS file or folder"):
        open_tdms(tmp_path / "nowhere")
    with pytest.raises(ConfigurationError, match=r"has no file '\*\*/\*\.tdms'"):
        open_tdms(tmp_path)


# Pulse echo and settings -----------------------------------------------------------------------------


def test_pulse_echo_positions_give_echoes_from_the_firing_pulse_on(tmp_path):
    properties = without(RAW, "wf_start_offset")
    one_channel(tmp_path, SHOT.waveform.counts, properties, group="probe")
    mapping = {"rename": {"probe": "B"}, "pulse_echo_positions": ("B",), "gain_db": 31.5, "averages": 64}
    found = played(tmp_path, **mapping)
    assert type(found) is Echo
    assert (found.gain_db, found.averages, found.waveform.pretrigger_samples) == (31.5, 64, 0)
    one_channel(tmp_path, SHOT.waveform.counts, RAW, group="probe")
    with pytest.raises(ConfigurationError, match="a pulse-echo record starts at the firing pulse"):
        open_tdms(tmp_path, TdmsMapping(**mapping))


def test_chosen_properties_become_settings(tmp_path):
    properties = RAW | {"Serial": "01F2", "Level (V)": 0.25, "Slot": np.int32(3)}
    one_channel(tmp_path, SHOT.waveform.counts, properties)
    names = {"Serial": "board_serial", "Level (V)": "trigger_level_v", "Slot": "slot"}
    settings = played(tmp_path, settings_properties=names).settings
    assert settings["board_serial"] == "01F2"
    assert settings["trigger_level_v"] == 0.25
    assert settings["slot"] == 3.0
    assert isinstance(settings["slot"], float)
    with pytest.raises(ConfigurationError, match="the property 'Board' is missing"):
        open_tdms(tmp_path, TdmsMapping(settings_properties={"Board": "board"}))


# Damage -------------------------------------------------------------------------------------------


def test_npTDMS_is_asked_for_where_it_is_missing(tmp_path, monkeypatch):  # noqa: N802
    write_set(tmp_path, 7, [SHOT])
    real = builtins.__import__

    def without_nptdms(name, *arguments, **keywords):
        if name.partition(".")[0] == "nptdms":
            raise ModuleNotFoundError("No module named 'nptdms'", name="nptdms")
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without_nptdms)
    with pytest.raises(ConfigurationError, match=r"pip install 'solimon\[tdms\]'"):
        open_tdms(tmp_path)


def cut_or_whole(folder):
    """Error of opening, or the keys that were found."""
    try:
        with open_tdms(folder) as recording:
            return list(recording.places)
    except ConfigurationError as error:
        return str(error)


def test_a_file_cut_anywhere_is_refused_unless_it_ends_with_a_whole_record(tmp_path):
    shots = [make_shot("B", index, index, n_samples=150) for index in (0, 1)]
    first = write_set(tmp_path, 7, shots[:1]).read_bytes()
    path = write_set(tmp_path, 7, shots)
    whole = path.read_bytes()
    assert whole.startswith(first)
    found = {}
    for n_bytes in {*range(0, len(whole), 5), len(first), len(first) + 40, len(whole) - 1, len(whole)}:
        path.write_bytes(whole[:n_bytes])
        found[n_bytes] = cut_or_whole(tmp_path)
    assert found.pop(len(whole)) == [shot.key for shot in shots]
    assert found.pop(len(first)) == [shots[0].key]
    # An empty segment is a whole file too, and has nothing to play.
    assert {error for error in found.values() if "set_000007.tdms" not in error} <= {
        error for error in found.values() if "has no record that matches" in error
    }
    assert "channel /'B'/'shot_1': cut short" in found[len(whole) - 1]
    assert "set_000007.tdms is cut short" in found[len(first) + 40]


def test_an_index_file_next_to_the_data_file_is_ignored(tmp_path):
    path = write_set(tmp_path, 7, [make_shot("B", 2, 42)])
    index = path.read_bytes().replace(b"TDSm", b"TDSh")
    write_set(tmp_path, 7, [SHOT])
    path.with_name(f"{path.name}_index").write_bytes(index)
    with open_tdms(tmp_path) as shots:
        assert list(shots.places) == [KEY]


def test_a_writer_that_crashed_leaves_an_unfinished_segment_whose_whole_records_count(tmp_path):
    shots = [make_shot("B", index, index, n_samples=150) for index in (0, 1)]
    first = write_set(tmp_path, 7, shots[:1]).read_bytes()
    path = write_set(tmp_path, 7, shots)
    unfinished = bytearray(path.read_bytes())
    struct.pack_into("<Q", unfinished, len(first) + 12, 0xFFFF_FFFF_FFFF_FFFF)
    path.write_bytes(unfinished)
    with open_tdms(tmp_path) as recording:
        assert recording.find(shots[1].key).waveform.counts.tobytes() == shots[1].waveform.counts.tobytes()
    path.write_bytes(unfinished[:-2])
    with pytest.raises(ConfigurationError, match="'shot_1': cut short, 149 of the last 150 samples are left"):
        open_tdms(tmp_path)


def test_a_file_damaged_anywhere_gives_our_error_or_a_record(tmp_path):
    path = write_set(tmp_path, 7, [make_shot("B", 0, 1, n_samples=100)])
    whole = path.read_bytes()
    random = np.random.default_rng(2)
    refused = 0
    places = range(0, len(whole), 4)
    for place in places:
        damaged = bytearray(whole)
        damaged[place] ^= int(random.integers(1, 256))
        path.write_bytes(damaged)
        try:
            with open_tdms(tmp_path) as recording:
                for key in recording.places:
                    assert recording.find(key).waveform.counts.size
        except ConfigurationError:
            refused += 1
    assert refused > len(places) // 3


def test_a_missing_file_is_reported_when_its_shot_is_read(tmp_path):
    path = write_set(tmp_path, 7, [SHOT])
    with open_tdms(tmp_path) as shots:
        path.unlink()
        with pytest.raises(ConfigurationError, match=r"there is no file .*set_000007.tdms any more"):
            shots.find(KEY)


def test_a_changed_file_is_reported_when_its_shot_is_read(tmp_path):
    write_set(tmp_path, 7, [SHOT])
    with open_tdms(tmp_path) as shots:
        write_set(tmp_path, 7, [make_shot("B", 3, 43, n_samples=200)])
        with pytest.raises(ConfigurationError, match="200 of 300 samples are left; the file was changed"):
            shots.find(KEY)
        write_set(tmp_path, 7, [make_shot("B", 4, 43)])
        shots.close()
        with pytest.raises(ConfigurationError, match=r"set_000007.tdms is no whole TDMS file \(KeyError"):
            shots.find(KEY)
