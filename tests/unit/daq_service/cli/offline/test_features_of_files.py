"""``solimon features``: foreign records as input, JSON or a table as output."""

import json

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.labview_files import polynomial, write
from support.synthetic_records import CALIBRATION, Scene, cos4

from analysis.waves.features import ALL_FEATURE_NAMES, EXTRACTOR_VERSION, extract_features
from daq_service.cli.main import cli
from daq_service.errors import UsageError

VOLTS_PER_COUNT = float(CALIBRATION.coefficients_v[1])
SCENE = Scene(noise_fraction=0.01)
N = 12


@pytest.fixture(scope="module")
def counts():
    return np.array([SCENE.waveform(seed).counts for seed in range(N)])


def run(*arguments):
    return CliRunner().invoke(cli, ["features", *map(str, arguments)], catch_exceptions=False)


def extracted_records(*arguments):
    answer = run(*arguments, "--json")
    assert answer.exit_code == 0, answer.output
    found = json.loads(answer.stdout)
    assert found["extractor_version"] == EXTRACTOR_VERSION
    return found["records"]


def save_array(folder, values, name="records.npy"):
    np.save(folder / name, values)
    return folder / name


def volts(scene=SCENE, n=N):
    return np.array([scene.volts(seed) for seed in range(n)])


def rejection_message(*arguments):
    with pytest.raises(UsageError) as caught:
        run(*arguments)
    return str(caught.value)


def test_counts_give_the_features_of_the_recorder(tmp_path, counts):
    path = save_array(tmp_path, counts)
    rows = extracted_records(path, "--volts-per-count", VOLTS_PER_COUNT, "--isw-fwhm-s", 64.7e-6)
    assert [(row["file"], row["index"]) for row in rows] == [(str(path), k) for k in range(N)]
    for seed, row in enumerate(rows):
        expected = extract_features(SCENE.waveform(seed))
        assert set(row) == {"file", "index", "flags", "quality", "sd", *ALL_FEATURE_NAMES}
        assert (row["flags"], row["quality"]) == (list(expected.flags), expected.quality)
        assert {name: row[name] for name in ALL_FEATURE_NAMES} == expected.values()


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("header", [True, False])
def test_a_text_table_gives_the_same_features_as_the_array(tmp_path, separator, header):
    values = np.round(volts(n=4), 6)
    lines = [separator.join(f"{value:.6f}" for value in row) for row in values]
    if header:
        lines.insert(0, separator.join(f"s{k}" for k in range(values.shape[1])))
    (tmp_path / "records.csv").write_text("\n".join(lines), encoding="utf-8")
    rows = extracted_records(tmp_path / "records.csv")
    expected = extracted_records(save_array(tmp_path, values))
    assert [row | {"file": ""} for row in rows] == [row | {"file": ""} for row in expected]


@pytest.mark.parametrize(
    ("fwhm_s", "rate_hz", "length_s"), [(30e-6, 50e6, 1e-3), (64.7e-6, 2e6, 1e-3), (95e-6, 1e6, 4e-3)]
)
def test_widths_and_amplitudes_are_learnt_at_any_rate_and_length(tmp_path, fwhm_s, rate_hz, length_s):
    """Records of 1 ms end before the default windows do."""
    scene = Scene(
        isw_v=0.4,
        width_s=2.747 * fwhm_s,
        rate_hz=rate_hz,
        pretrigger_samples=round(150e-6 * rate_hz),
        n_samples=round(length_s * rate_hz),
        noise_fraction=0.02,
        offset_v=-0.7,
    )
    path = save_array(tmp_path, volts(scene))
    answer = run(path, "--rate-hz", rate_hz, "--pretrigger-s", 150e-6, "--json")
    rows = json.loads(answer.stdout)["records"]
    assert [row["flags"] for row in rows] == [[]] * N
    # 2 % of noise shake a record's time of flight by .1 us at 10 MS/s, .3 us at a tenth of the samples.
    assert [row["tof_mf_s"] for row in rows] == pytest.approx([scene.tof_s] * N, abs=1.5e-6)
    assert f"ISW {1e6 * fwhm_s:.0f}" in answer.stderr.replace(".", " ") or "ISW" in answer.stderr


def test_shots_are_compared_with_the_given_transducer_properties(tmp_path):
    path = save_array(tmp_path, volts())
    assert {tuple(row["flags"]) for row in extracted_records(path)} == {()}
    assert {tuple(row["flags"]) for row in extracted_records(path, "--isw-amplitude-v", 30.0)} == {
        ("missed",)
    }
    assert {tuple(row["flags"]) for row in extracted_records(path, "--psw-window-s", "4e-4,9e-4")} == {
        ("double", "no_psw")
    }


def test_rail_counts_determine_clipping(tmp_path, counts):
    path = save_array(tmp_path, counts)
    scale = ("--volts-per-count", VOLTS_PER_COUNT)
    assert not any("clipped" in row["flags"] for row in extracted_records(path, *scale))
    rows = extracted_records(path, *scale, "--rail-counts", "-8192,8191")  # 2.5 V, half of the waves
    assert all("clipped" in row["flags"] for row in rows)


def test_a_weak_strike_is_found_by_the_others_of_its_file(tmp_path):
    values = volts()
    values[5] *= 0.2
    rows = extracted_records(save_array(tmp_path, values))
    assert [row["index"] for row in rows if row["flags"]] == [5]
    assert rows[5]["flags"] == ["missed"]
    assert rows[5]["isw_amplitude_v"] == pytest.approx(1.0, rel=0.01)
    assert rows[5]["tof_mf_s"] is None


def test_a_single_record_is_compared_only_with_a_given_amplitude(tmp_path):
    path = save_array(tmp_path, 0.15 * volts(n=1))
    assert extracted_records(path)[0]["flags"] == []
    assert extracted_records(path, "--isw-amplitude-v", 5.0)[0]["flags"] == ["missed"]


def test_inverted_waves_are_reported_with_their_remedy(tmp_path):
    answer = CliRunner().invoke(cli, ["features", str(save_array(tmp_path, -volts(n=3))), "--json"])
    assert [row["flags"] for row in json.loads(answer.stdout)["records"]] == [["inverted"]] * 3
    assert answer.stderr.count("3 of 3 records are inverted") == 1
    assert "reverse the sign of the values" in answer.stderr


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200, 9.9e37, -9.91e37, 1e38])
def test_missing_or_overloaded_samples_cost_only_their_record(tmp_path, value):
    values = volts()
    values[3, 700:1200] = value
    rows = extracted_records(save_array(tmp_path, values))
    assert [row["flags"] for row in rows] == [["disturbed"] if k == 3 else [] for k in range(N)]
    assert all(rows[3][name] is None for name in ALL_FEATURE_NAMES)


def test_invalid_cells_and_short_rows_cost_only_their_record(tmp_path):
    lines = [";".join(f"{value:.6f}".replace(".", ",") for value in row) for row in volts()]
    lines[2] = lines[2].replace(";0,", ";broken;0,", 1)
    lines[7] = lines[7][:3000]
    (tmp_path / "records.csv").write_text("\n".join(lines), encoding="utf-8")
    rows = extracted_records(tmp_path / "records.csv")
    assert [row["flags"] for row in rows] == [["disturbed"] if k in (2, 7) else [] for k in range(N)]
    assert rows[7]["tof_mf_s"] is None


def test_a_row_of_missing_values_is_a_record_and_a_row_of_words_is_not(tmp_path):
    values = volts(n=3)
    values[1] = np.nan
    np.savetxt(tmp_path / "records.csv", values, delimiter=",", fmt="%.6f", header="10 MHz, 1\nRig, 3")
    assert [row["flags"] for row in extracted_records(tmp_path / "records.csv")] == [[], ["disturbed"], []]
    (tmp_path / "words.csv").write_text("a,b\nno,numbers", encoding="utf-8")
    assert "record 0: 'no,numbers'; a row is a record" in rejection_message(tmp_path / "words.csv")


def test_a_table_with_samples_in_rows_is_rejected(tmp_path):
    assert "a row of a table is a record, not a sample" in rejection_message(
        save_array(tmp_path, volts(n=2).T)
    )


@pytest.mark.parametrize("option", ["--rate-hz", "--pretrigger-s", "--volts-per-count", "--isw-fwhm-s"])
def test_numbers_that_are_not_finite_are_refused(option):
    answer = CliRunner().invoke(cli, ["features", "none.npy", option, "nan"])
    assert answer.exit_code == 2
    assert f"Invalid value for '{option}': nan is not a finite number" in answer.stderr


def test_an_unreadable_file_does_not_affect_other_results(tmp_path):
    bad = tmp_path / "bad.npy"
    bad.write_bytes(b"hello")
    good = save_array(tmp_path, volts(n=2))
    answer = CliRunner().invoke(cli, ["features", str(bad), str(good), str(tmp_path / "no.npy"), "--json"])
    found = json.loads(answer.stdout)
    assert [row["file"] for row in found["records"]] == [str(good)] * 2
    assert [item["file"] for item in found["refused"]] == [str(bad), str(tmp_path / "no.npy")]
    assert found["refused"][0]["reason"].endswith("not a .npy file of numbers, records x samples")
    assert isinstance(answer.exception, UsageError)


@pytest.mark.parametrize("seed", range(3))
def test_records_of_noise_are_missed_strikes_and_set_no_width(tmp_path, seed):
    noise = 1e-3 * np.random.default_rng(seed).standard_normal((N, 13_000))
    rows = extracted_records(save_array(tmp_path, noise))
    assert [row["flags"] for row in rows] == [["missed"]] * N
    noise[:, 5000] += 0.5  # a spike is not a wave
    assert all(row["quality"] == "bad" for row in extracted_records(save_array(tmp_path, noise)))


def test_a_file_may_have_one_record(tmp_path):
    (row,) = extracted_records(save_array(tmp_path, SCENE.volts(0)))
    assert row["quality"] == "good"


def test_the_text_table_has_a_line_per_record(tmp_path):
    answer = run(save_array(tmp_path, volts()))
    assert answer.stdout.count("│ good") == N
    assert "330.0" in answer.stdout


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        (np.zeros((2, 3, 4)), (), "records x samples"),
        (np.array([["a", "b"]]), (), "must be numbers"),
        (np.zeros((0, 13_000)), (), "holds no record"),
        (np.zeros((3, 0)), (), "is empty"),
        (np.zeros((3, 13_000), dtype=np.int16), (), "--volts-per-count"),
        (np.zeros((3, 13_000)), ("--rail-counts", "-10,10"), "--volts-per-count"),
        (np.zeros((3, 13_000)), ("--rail-counts", "10"), "LOW,HIGH"),
        (np.zeros((3, 13_000)), ("--psw-window-s", "9e-4,2e-4"), "FROM,TO"),
        (np.zeros((3, 3_000)), (), "record 0: the record ends 200 us after its trigger"),
        (np.zeros((3, 13_000)), ("--pretrigger-s", "1"), "record 0: pretrigger_samples"),
    ],
)
def test_an_invalid_record_is_rejected_with_a_remedy(tmp_path, values, options, message):
    assert message in rejection_message(save_array(tmp_path, values), *options)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("records.txt", b"1,2,3", "not .txt"),
        ("records.npy", b"hello", "not a .npy file"),
        ("records.csv", b"", "holds no record"),
        ("records.csv", b"\xff\xfe\x00", "in UTF-8: byte 1 of line 1 is 0xff; save it as UTF-8"),
        ("records.csv", b"0.5,1.5\nso,many", "record 1: 'so,many'; a row is a record of numbers"),
        (
            "records.csv",
            b"0.5,1.5\n# at 3, 4",
            "record 1: '# at 3, 4' is a comment; comments must come before",
        ),
        ("records.csv", b"5,1\n0,1", "--volts-per-count"),
        ("records.h5", b"hello", "records.h5"),
        ("records.tdms", b"hello", "records.tdms"),
    ],
)
def test_a_file_of_another_kind_is_rejected_with_its_name(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    assert message in rejection_message(tmp_path / name)


@pytest.mark.parametrize(
    ("changed", "encoding"),
    [
        (lambda lines: [line + "," for line in lines], "utf-8"),  # separators at line ends
        (lambda lines: ["sep=;", *(line.replace(",", ";").replace(".", ",") for line in lines)], "utf-8-sig"),
        (lambda lines: [line.replace(",", "\t") for line in lines], "utf-16"),
        (lambda lines: [",".join(map(str, range(13_000))), *lines], "utf-8"),  # columns' numbers
        (
            lambda lines: (
                ["," + ",".join(map(str, range(13_000)))] + [f"{k},{v}" for k, v in enumerate(lines)]
            ),
            "utf-8",
        ),
    ],
)
def test_records_as_other_programs_write_them_are_read_alike(tmp_path, changed, encoding):
    lines = [",".join(f"{v:.4f}" for v in record) for record in volts(n=3)]
    for name, content, code in (("a.csv", lines, "utf-8"), ("b.csv", changed(lines), encoding)):
        (tmp_path / name).write_text("\n".join(content), encoding=code)
    expected, found = extracted_records(tmp_path / "a.csv"), extracted_records(tmp_path / "b.csv")
    assert [{**row, "file": ""} for row in found] == [{**row, "file": ""} for row in expected]
    assert [row["flags"] for row in found] == [[]] * 3


def test_an_hdf5_file_of_another_program_is_rejected_with_a_remedy(tmp_path):
    with h5py.File(tmp_path / "matlab.h5", "w", userblock_size=512) as file:
        file.create_dataset("waves", data=volts(n=1)).attrs["MATLAB_class"] = np.bytes_("double")
    assert "records of other programs (MATLAB, pandas): save them as .npy" in rejection_message(
        tmp_path / "matlab.h5"
    )


def write_tdms(path, properties):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        for k, record in enumerate(volts(n=3)):
            writer.write_segment([nptdms.ChannelObject("A", f"shot {k}", record, properties)])
    return path


def test_scaled_labview_values_are_volts_unless_another_unit_is_given(tmp_path):
    wave = {"wf_increment": 1.0 / SCENE.rate_hz}
    options = ("--pretrigger-s", SCENE.pretrigger_samples / SCENE.rate_hz)
    rows = extracted_records(write_tdms(tmp_path / "a.tdms", wave), *options)
    assert [row["tof_mf_s"] for row in rows] == [
        row["tof_mf_s"] for row in extracted_records(save_array(tmp_path, volts(n=3)), *options)
    ]
    assert "'mbar'" in rejection_message(
        write_tdms(tmp_path / "b.tdms", {**wave, "unit_string": "mbar"}), *options
    )
    assert "--rate-hz" in rejection_message(write_tdms(tmp_path / "c.tdms", {}), *options)


def short_volts(n, samples=800):
    return volts(SCENE.with_(rate_hz=1e6, pretrigger_samples=100, n_samples=samples), n)


WAVE = {"wf_increment": 1e-6, "wf_start_offset": -1e-4, "unit_string": "V"}


def test_appended_records_of_labview_are_split(tmp_path):
    """4,000 samples with `wf_samples` = 800 are five records, next to other channels and groups."""
    records, longer = short_volts(5), short_volts(3, 1_000)
    counts = np.round(records / 1e-3).astype(np.int16)
    scaled = {**WAVE, "wf_samples": 800, **polynomial([0.0, 1e-3])}
    path = write(
        tmp_path / "appended.tdms",
        [
            ("B", "shots", records[:2].ravel(), {**WAVE, "wf_samples": 800}),
            ("B", "shots", np.zeros(0), {}),
            ("B", "shots", records[2:].ravel(), {}),
            ("C", "shots", longer.ravel(), {**WAVE, "wf_samples": 1_000}),
            ("C", "one", longer[0], {**WAVE, "wf_samples": 1}),  # as DAQmx logs it
            ("D", "raw", counts.ravel(), scaled),
            ("D", "remarks", ["wet", "dry"], {}),
        ],
    )
    (tmp_path / "appended.tdms_index").write_bytes(b"of another file")
    rows = extracted_records(path)
    assert [row["flags"] for row in rows] == [[]] * 14
    of_each = [row["tof_mf_s"] for row in extracted_records(save_array(tmp_path, records), "--rate-hz", 1e6)]
    assert [row["tof_mf_s"] for row in rows[:5]] == of_each
    assert rows[5]["tof_mf_s"] == rows[8]["tof_mf_s"]
    assert [row["tof_mf_s"] for row in rows[9:]] == pytest.approx(of_each, abs=1e-7)  # of the codes' rounding


@pytest.mark.parametrize(
    ("samples", "properties", "message"),
    [
        (3_900, {"wf_samples": 800}, "3900 samples are not a whole number of records of 800"),
        (4_000, {"wf_samples": 800, "wf_increment": 0.0}, "wf_increment is 0.0 s"),
        (4_000, {"wf_samples": "many"}, "wf_samples is 'many', no number"),
        (4_000, {"wf_samples": 90}, "4000 samples are not a whole number of records of 90"),
        (4_000, {"wf_samples": 50}, "the trigger at sample 100 is outside the record of 50 samples"),
    ],
)
def test_appended_records_that_fit_no_channel_are_refused_with_it(tmp_path, samples, properties, message):
    values = short_volts(5).ravel()[:samples]
    path = write(tmp_path / "a.tdms", [("B", "shots", values, {**WAVE, **properties})])
    assert f"group 'B', channel 'shots': {message}" in rejection_message(path)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    for name in ("no.npy", "no.csv", "no.h5", "no.tdms"):
        assert name in rejection_message(tmp_path / name)


def test_a_second_pulse_in_the_file_is_seen_with_its_reflection(tmp_path):
    values = volts()
    t, later = SCENE.time_s(), SCENE.isw_time_s + 320e-6
    values[4] += 0.3 * SCENE.isw_v * (cos4(t, later) + SCENE.amplitude_ratio * cos4(t, later + SCENE.tof_s))
    rows = extracted_records(save_array(tmp_path, values))
    assert [row["index"] for row in rows if row["flags"]] == [4]
    assert "double" in rows[4]["flags"]
