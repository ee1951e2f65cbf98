"""The files are NeXus: h5py alone, knowing only NeXus's attributes, finds everything; so does h5dump."""

import io
import json
import shutil
import subprocess
from dataclasses import replace
from datetime import datetime

import h5py
import numpy as np
import pytest
from support.archived_sets import CURVED, make_echo, make_set, make_shot

from daq_service.archive.layout import build_set_image

NS_PER_S = 1_000_000_000


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("nexus") / "set.h5"
    path.write_bytes(build_set_image(make_set()))
    return path


@pytest.fixture(scope="module")
def file(path):
    with h5py.File(path) as opened:
        yield opened


def text(value):
    return value.decode() if isinstance(value, bytes) else str(value)


def texts(values):
    return [text(value) for value in np.atleast_1d(values)]


def groups_of(file, nx_class):
    found = []

    def look(name, item):
        if text(item.attrs.get("NX_class", "")) == nx_class:
            found.append(item)

    file.visititems(look)
    return found


def record_groups(file):
    return [group for group in groups_of(file, "NXdata") if "position" in group.attrs]


def test_the_preview_shows_mean_and_extremes_of_the_shots(file):
    preview = file["entry/preview"]
    volts = np.stack([shot.waveform.volts() for shot in make_set().shots if shot.key.position == "B"])
    # 300 samples are below the 500 points of a preview, so nothing is merged; stored as float32.
    for kind, expected in (
        ("mean", volts.mean(axis=0)),
        ("min", volts.min(axis=0)),
        ("max", volts.max(axis=0)),
    ):
        np.testing.assert_allclose(preview[f"B_{kind}"][()], expected, rtol=0, atol=10 * 2.0**-24)


def test_a_long_record_is_previewed_by_what_it_reaches_between_points():
    shot = make_shot("B", 0, 1, n_samples=1201)
    record = make_set()
    image = build_set_image(type(record)(**{**fields_of(record), "shots": [shot], "echoes": [make_echo(2)]}))
    with h5py.File.in_memory(image) as opened:
        preview = opened["entry/preview"]
        time_s, low, high = (preview[name][()] for name in ("time", "B_min", "B_max"))
    volts = shot.waveform.volts()
    assert time_s.size == 401  # 1201 samples, three a point: the fewest whole samples that give at most 500
    np.testing.assert_array_equal(time_s, shot.waveform.time_s()[::3])
    np.testing.assert_array_equal(low[:-1], volts[:1200].reshape(400, 3).min(axis=1).astype(np.float32))
    np.testing.assert_array_equal(high[:-1], volts[:1200].reshape(400, 3).max(axis=1).astype(np.float32))
    assert high[-1] == low[-1] == np.float32(volts[-1])


def fields_of(record):
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def test_every_group_says_its_class(file):
    classes = {}

    def look(name, item):
        if isinstance(item, h5py.Group):
            classes[name] = item.attrs.get("NX_class")

    file.visititems(look)
    assert all(value is not None and text(value).startswith("NX") for value in classes.values()), classes


def test_each_transducer_has_its_records_and_its_detector(file):
    kinds = {text(group.attrs["position"]): text(group.attrs["signal"]) for group in record_groups(file)}
    assert kinds == {"A": "record", "B": "waveform", "C": "waveform"}
    for detector in groups_of(file, "NXdetector"):
        assert detector["sample_rate"][()] in (1e7, 1e8)
        assert text(detector["sample_rate"].attrs["units"]) == "Hz"


def test_the_file_names_its_maker_and_its_version(file):
    assert (file.attrs["creator"], file.attrs["creator_version"]) == ("solimon", "0.1.0")
    program = file["entry/program_name"]
    assert (program.asstr()[()], program.attrs["version"]) == ("solimon", "0.1.0")


def test_text_of_attributes_is_text_to_a_reader(file):
    """But for the two names that HDF5's own rules for axes give a fixed length."""

    def look(name, item):
        for key, value in item.attrs.items():
            if key not in ("CLASS", "NAME"):
                assert np.asarray(value).dtype.kind != "S", (name, key)

    look("", file)
    file.visititems(look)


def test_the_polynomial_in_the_file_is_the_truth(file):
    group = file["entry/C_waveforms"]
    detector = file["entry/instrument/C_waveforms"]
    volts = np.polynomial.polynomial.polyval(
        group["waveform"][0].astype(float), detector["calibration_coefficients"][()]
    )
    shot = next(shot for shot in make_set().shots if shot.key.position == "C")
    np.testing.assert_array_equal(volts, shot.waveform.volts())
    np.testing.assert_array_equal(detector["calibration_coefficients"][()], CURVED.coefficients_v)


def test_times_are_those_of_the_records(file):
    shots = {shot.sequence: shot for shot in make_set().records}
    for group in record_groups(file):
        start = datetime.fromisoformat(text(group["shot_time"].attrs["start"])[:26] + "+00:00")
        for row, sequence in enumerate(group["shot_id"][()].tolist()):
            np.testing.assert_array_equal(group["time"][()], shots[sequence].waveform.time_s())
            utc_s = start.timestamp() + group["shot_time"][row]
            # A float64 of seconds since 1970 is good to 0.24 us; the start is cut to 1 us.
            assert abs(utc_s - shots[sequence].stamp.utc_ns / NS_PER_S) < 2e-6


def test_transducers_sampled_alike_share_their_time_axis(file):
    assert file["entry/B_waveforms/time"] == file["entry/C_waveforms/time"]
    assert text(file["entry/C_waveforms/time"].attrs["target"]) == "/entry/B_waveforms/time"


def test_each_record_has_a_row_of_its_shot(file):
    table = file["entry/shots"]
    records = make_set().records
    assert table["shot_id"][()].tolist() == [item.sequence for item in records]
    assert texts(table["position"][()]) == [item.key.position for item in records]
    assert table["attempt"][()].tolist() == [item.key.attempt for item in records]
    assert table["utc_ns"][()].tolist() == [item.stamp.utc_ns for item in records]
    assert table["mono_ns"][()].tolist() == [item.stamp.mono_ns for item in records]
    assert texts(table["boot_id"][()]) == [item.stamp.boot_id for item in records]


def test_receiver_settings_are_stored_with_the_echo(file):
    group = file["entry/A_pulse_echo"]
    assert (group["gain"][0], group["offset"][0], group["averages"][0]) == (31.5, -0.25, 64)
    assert (text(group["gain"].attrs["units"]), text(group["offset"].attrs["units"])) == ("dB", "V")


def test_the_truth_of_simulated_shots_has_units_and_marks_missing_values(file):
    truth = file["entry/truth"]
    assert truth["shot_id"][()].tolist() == [40, 41, 42, 43, 44]
    assert truth["drop_height_m"][1] == 5.1e-3
    assert text(truth["drop_height_m"].attrs["units"]) == "m"
    assert text(truth["depth_fraction"].attrs["units"]) == ""
    assert truth["drop_height_m"].attrs["known"].tolist() == [0, 1, 0, 0, 0]
    assert truth["depth_fraction"].attrs["known"].tolist() == [0, 1, 1, 0, 0]


def test_the_file_says_what_was_missed_and_which_attempt_counts(file):
    missed = file["entry/missed"]
    assert texts(missed["position"][()]) == ["D", "D", "D"]
    assert missed["shot_index"][()].tolist() == [0, 0, 1]
    assert missed["attempt"][()].tolist() == [0, 1, 0]
    assert set(texts(missed["reason"][()])) == {"no_trigger"}
    assert set(texts(missed["cause"][()])) == {"no trigger within 5 s: größer"}
    table = file["entry/shots"]
    outcome = dict(zip(table["shot_id"][()].tolist(), texts(table["outcome"][()]), strict=True))
    assert outcome == {40: "accepted", 41: "accepted", 42: "superseded", 43: "accepted", 44: "accepted"}
    assert (
        text(file["entry/trouble"][()]) == "ConnectionLostError: the board in slot 3 does not answer: größer"
    )


def test_instrument_data_has_units_and_marks_missing_values(file):
    settings = file["entry/settings"]
    assert settings["shot_id"][()].tolist() == [40, 41, 42, 43, 44]
    assert texts(settings["board"][()]) == ["", "01A2B3C4", "", "01A2B3C5", ""]
    assert settings["board"].attrs["known"].tolist() == [0, 1, 0, 1, 0]
    assert settings["trigger_level_v"][1] == 0.4
    assert text(settings["trigger_level_v"].attrs["units"]) == "V"
    assert text(settings["driver_version"][0]) == "1.5"


def test_the_environment_of_a_set_has_units(file):
    environment = file["entry/environment"]
    assert text(environment["supply_state"][()]) == "on"
    assert environment["voltage_v"][()] == 0.1 + 0.2
    units = {name: text(environment[name].attrs["units"]) for name in ("voltage_v", "charge_coulomb")}
    assert units == {"voltage_v": "V", "charge_coulomb": "C"}


def test_facts_and_causes_are_in_the_file(file):
    entry = file["entry"]
    assert (entry["set_index"][()], entry["due_h"][()]) == (7, 4.0)
    assert text(entry["start_time"][()]) == "2024-01-01T04:00:00.000000123Z"
    assert text(entry["instrument/name"][()]) == "simulated"
    assert text(entry["program_name"].attrs["configuration"]) == "ab" * 32
    table = entry["positions"]
    assert texts(table["cause"][()]) == ["", "", "no trigger within 5 s: größer", "3 missed: größer"]
    assert table["n_planned"][()].tolist() == [1, 2, 2, 2]
    assert table["n_taken"][()].tolist() == [1, 3, 1, 0]
    assert json.loads(entry["provenance/data"][0]) == make_set().provenance
    assert text(entry["provenance/type"][()]) == "application/json"


def test_waveforms_are_chunked_by_shot_with_filters_that_every_reader_has(file):
    signal = file["entry/B_waveforms/waveform"]
    assert signal.dtype == np.dtype("<i2")
    assert file["entry/C_waveforms/waveform"].dtype == np.dtype("<i4")
    assert signal.chunks == (1, 300)
    assert (signal.compression, signal.compression_opts, signal.shuffle, signal.fletcher32) == (
        "gzip",
        1,
        True,
        True,
    )


def test_every_byte_of_data_is_under_a_checksum(file):
    """Chunks have Fletcher32; compact data and attributes lie in headers that HDF5 guards itself."""
    seen = []

    def check(name, item):
        if not isinstance(item, h5py.Dataset):
            return
        layout = item.id.get_create_plist().get_layout()
        assert item.fletcher32 if layout == h5py.h5d.CHUNKED else layout == h5py.h5d.COMPACT, name
        assert h5py.check_vlen_dtype(item.dtype) is None, name
        seen.append(name)

    file.visititems(check)
    assert len(seen) > 80


needs_h5dump = pytest.mark.skipif(
    shutil.which("h5dump") is None, reason="h5dump is not installed (Debian package hdf5-tools)"
)


def h5dump(*arguments):
    result = subprocess.run(
        ["h5dump", *map(str, arguments)], capture_output=True, text=True, timeout=60, check=False
    )
    assert (result.returncode, result.stderr) == (0, "")
    return result.stdout


@needs_h5dump
def test_h5dump_reads_the_whole_file(path):
    dump = h5dump(path)
    assert dump.count('GROUP "') >= 14
    assert '"Set 7, hour 4"' in dump
    assert '"no trigger within 5 s: gr' in dump


def test_the_external_calibration_of_a_sensor_is_an_attribute_of_its_detector():
    record = make_set()
    known = {"certificate": "", "due_on": "2027-01-15", "sensitivity_v_per_n": 0.5, "calibrated_on": None}
    configuration = {"positions": {"B": {"calibration": known}}}
    image = build_set_image(replace(record, provenance={**record.provenance, "configuration": configuration}))
    with h5py.File(io.BytesIO(image)) as file:
        found = {
            (text(detector.attrs["position"]), name): value
            for detector in groups_of(file, "NXdetector")
            for name, value in detector.attrs.items()
            if name.startswith("sensor_")
        }
    assert found == {("B", "sensor_due_on"): "2027-01-15", ("B", "sensor_sensitivity_v_per_n"): 0.5}
