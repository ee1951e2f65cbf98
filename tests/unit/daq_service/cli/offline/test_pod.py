"""`solimon pod`: tables, tests on the twin with their true losses, the figure, refusals."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from support.small_experiment import run, small_settings

from analysis.statistics.detection_probability import PROBABILITIES
from daq_service.archive import FolderSetReader
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import AlarmRow, AssessmentRow
from daq_service.cli.main import cli
from daq_service.cli.offline.pod.command import compute_pods
from daq_service.cli.offline.pod.figure import draw_pods
from daq_service.cli.offline.pod.runs import ONE_SET, Result, read_runs, summarize_sensor
from daq_service.cli.reproduce import style
from daq_service.settings.tree import Settings

LOSSES = (0.31, 0.42, 0.45, 0.58, 0.6, 0.77, 0.9, 1.1)
CORROSION = {"onset_h": 10.0, "reference_h": 16.0, "depth_fraction": 0.4}
ESTIMAND = "mean over a disc of 10 mm radius around the contact, lost since the baseline"


def pod(*words):
    return CliRunner().invoke(cli, ["pod", *map(str, words)])


def message(done):
    assert done.exit_code != 0, done.output
    return f"{done.exception}{done.output}"


def write(path, header, *rows):
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    return path


def losses(path, *rows):
    """Write a table of eight sensors with a detection each, and more rows."""
    return write(path, "sensor,loss_m,detected", *(f"s{k},{x * 1e-3},1" for k, x in enumerate(LOSSES)), *rows)


@pytest.fixture(scope="module")
def tests(tmp_path_factory):
    """Return two tests on the twin: B and C corrode after the baseline, D stays sound."""
    folders = []
    for seed in (1, 2):
        folder = tmp_path_factory.mktemp(f"seed-{seed}")
        settings = small_settings(
            schedule={"phases": [{"until_h": 16.0, "interval_h": 0.5}]},
            twin={"seed": seed, "thinning": {"B": CORROSION, "C": CORROSION}},
        )
        assert run(settings, folder)
        folders.append(folder)
    return folders


def test_a_table_gives_lengths_in_mm_and_false_alarms_apart(tmp_path):
    done = pod(losses(tmp_path / "losses.csv", "s0,0,1", "s1,0,0", "s2,0,0"))
    assert done.exit_code == 0, done.output
    title, head, row = done.stdout.splitlines()
    assert title == f"probability of detection (POD) of wall loss: {ESTIMAND}"
    assert head.split()[:6] == ["rule", "sensors", "detected", "a50", "a90", "a90/95"]
    # Published factor of eight values, 2.583.
    logs = np.log(LOSSES)
    a90_95 = np.exp(logs.mean() + 2.583 * logs.std(ddof=1))
    assert row.split()[:3] == ["table", "8", "8"]
    assert f"{a90_95:.2f} mm  1 of 3 sensors (0.8 to 90.6 %)" in row


def test_rules_are_separate_and_a_refused_one_has_its_reason(tmp_path):
    rows = [f"fast,s{k},{x * 1e-3},1" for k, x in enumerate(LOSSES)]
    rows += [f"slow,s{k},{x * 2e-3},{int(k > 1)}" for k, x in enumerate(LOSSES)]
    done = pod(write(tmp_path / "all.csv", "rule,sensor,loss_m,detected", *rows, "few,s0,0.001,1"), "--json")
    answer = json.loads(done.stdout)
    assert answer["estimand"] == ESTIMAND
    fast, slow, few = answer["rules"]
    assert (fast["n_detected"], slow["n_detected"]) == (8, 6)
    assert slow["a90_95_m"] > fast["a90_95_m"] > fast["a90_m"] > fast["a50_m"]
    assert fast["refused"] is None
    assert fast["rate_interval"] is None
    assert few["refused"].startswith("1 sensors with a wall loss; a POD needs at least 6")
    assert "a50_m" not in few
    assert "few: refused, 1 sensors" in pod(tmp_path / "all.csv").stdout.splitlines()[-1]


def test_signals_have_the_pod_of_one_set_with_the_scatter_of_sensors(tmp_path):
    random = np.random.default_rng(3)
    rows = ["s0,0,9", "s0,0,1", "s1,0,2"]
    for k in range(8):
        gain = np.exp(0.3 * random.standard_normal())
        rows += [f"s{k},{x * 1e-3},{10 * x * gain * np.exp(0.1 * random.standard_normal())}" for x in LOSSES]
    table = write(tmp_path / "signals.csv", "sensor,loss_m,a_hat", *rows)
    (found,) = json.loads(pod(table, "--threshold", "5", "--json").stdout)["rules"]
    assert found["rule"] == ONE_SET
    assert found["slope"] == pytest.approx(1.0, abs=0.1)
    # 5 of 10 per mm; the scatter of 0.3 between eight sensors has a standard error of 27 %.
    assert found["a50_m"] == pytest.approx(0.5e-3, rel=0.35)
    assert 0.1 < found["sd_sensors"] < 0.6
    assert found["sd_looks"] == pytest.approx(0.1, rel=0.35)
    assert (found["false_alarms"], found["n_sound"]) == (1, 2)


def test_signals_of_tests_are_fitted_from_the_a50_of_k_of_n_on():
    """Below, the signal is a floor of noise: with it the slope would be about half."""
    random = np.random.default_rng(4)
    loss_m = np.array([0.01, 0.02, 0.05, 0.1, 0.2, *LOSSES]) * 1e-3
    results = [
        Result(rule="3 of 5 sets", sensor=f"s{k}", loss_m=x * 0.5e-3, signal=1.0)
        for k, x in enumerate(LOSSES)
    ]
    results += [
        Result(rule=ONE_SET, sensor=f"s{k}", loss_m=x, signal=signal * noise)
        for k in range(8)
        for x, signal, noise in zip(
            loss_m, np.maximum(2e3 * loss_m, 0.4), np.exp(0.05 * random.standard_normal(13)), strict=True
        )
    ]
    of_sets, of_signals = compute_pods(results)
    assert 0.2e-3 < of_sets.curve.a50_m < 0.31e-3
    assert of_signals.curve.slope == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("ending", ["svg", "png"])
def test_the_figure_has_curve_bound_and_estimand(tmp_path, ending):
    figure = tmp_path / f"pod.{ending}"
    assert pod(losses(tmp_path / "losses.csv"), "--figure", figure).exit_code == 0
    content = figure.read_bytes()
    assert content.startswith(b"<?xml" if ending == "svg" else b"\x89PNG")
    assert pod(tmp_path / "losses.csv", "--figure", figure).exit_code == 0
    assert figure.read_bytes() == content
    assert "ends in .svg or .png" in message(pod(tmp_path / "losses.csv", "--figure", tmp_path / "pod.pdf"))


def test_the_figure_names_each_of_many_rules_with_its_bound(tmp_path):
    rows = [f"r{rule},s{k},{x * 1e-3},1" for rule in range(8) for k, x in enumerate(LOSSES)]
    table = write(tmp_path / "rules.csv", "rule,sensor,loss_m,detected", *rows)
    found = read_runs([table], None, None)
    curves = {one.rule: one.curve for one in compute_pods(found)}
    unbound = replace(curves["r0"], bound_m=np.full(PROBABILITIES.size, np.inf))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(style.RULES, "svg.fonttype", "none")
        content = draw_pods({**curves, "open": unbound}, ESTIMAND, "svg").decode()
    assert ESTIMAND in content
    bound_mm = f"{1e3 * curves['r0'].a90_95_m:#.3g} mm"
    assert "open, no a90/95" in content
    assert [f"r{rule}, a90/95 {bound_mm}" in content for rule in range(8)] == 8 * [True]


@pytest.mark.parametrize(
    ("header", "row", "reason"),
    [
        (
            "sensor,loss_m,detected",
            "s9,0.85,1",
            "loss_m = 0.85 in row 8 is outside 0 to 0.1 m. Did you mean 0.00085?",
        ),
        ("sensor,loss_m,detected", "s9,-0.001,1", "loss_m = -0.001 in row 8 is outside"),
        ("sensor,loss_m,detected", "s9,0.001,2", "detected = 2 is neither 0 nor 1"),
        ("sensor,loss_m,detected", "s9,,1", "loss_m = '' in row 8 is no number"),
        ("sensor,loss_mm,detected", "s9,1,1", "it has sensor, loss_mm, detected"),
        ("sensor,loss_m,a_hat", "s9,0.001,1", "give --threshold"),
        ("sensor,loss_m,detected", "s3,0.001,1", "sensor 's3' has 2 values, which are not independent"),
    ],
    ids=["mm", "negative", "detected", "missing", "column", "threshold", "looks"],
)
def test_a_table_that_cannot_be_used_names_value_and_remedy(tmp_path, header, row, reason):
    rows = [f"s{k},{x * 1e-3},1" for k, x in enumerate(LOSSES)]
    assert reason in message(pod(write(tmp_path / "table.csv", header, *rows, row)))


def test_the_losses_of_a_test_are_the_stored_truth_since_the_baseline(tests):
    folder, looks = tests[0], {}
    for one in read_runs([folder], None, None):
        if one.rule == ONE_SET:
            looks.setdefault(one.sensor.rpartition(":")[2], []).append(one.loss_m)
    with open_catalogue(folder) as catalogue:
        settings = catalogue.read_experiment().configuration
        assessed = catalogue.rows(AssessmentRow, position="B")
    stored = {}
    reader = FolderSetReader(folder)
    for key, reference in reader.sets().items():
        shots = [shot for shot in reader.read_set(reference).records if shot.key.position == "B"]
        if shots:
            stored[key.set_index] = shots[-1].truth["depth_fraction"]
    before = np.mean([stored[row.set_index] for row in assessed if row.in_baseline])
    after = [stored[row.set_index] for row in assessed if row.outlier is not None and not row.in_baseline]
    thickness_m = settings["positions"]["B"]["plate"]["thickness_m"]
    np.testing.assert_allclose(looks["B"], thickness_m * (np.array(after) - before), atol=1e-9)
    assert max(looks["B"]) > 1e-3
    assert max(looks["D"]) == 0.0


def test_each_sensor_of_a_test_has_one_loss_and_one_sound_wall_by_each_rule(tests):
    results = [one for one in read_runs(tests, None, None) if one.rule != ONE_SET]
    assert {one.rule for one in results} == {
        *("control chart", "3 of 5 sets", "diagnosis WALL", "alarm of the service")
    }
    lost = [(one.rule, one.sensor) for one in results if one.loss_m > 0.0]
    assert len(lost) == len(set(lost)) == 4 * 4
    assert {sensor[-1] for _, sensor in lost} == {"B", "C"}
    assert sum(one.rule == "3 of 5 sets" and one.signal == 1.0 for one in results if one.loss_m > 0.0) == 4
    for folder in tests:
        with open_catalogue(folder) as catalogue:
            raised = {row.position for row in catalogue.rows(AlarmRow) if row.alarm_class == "damage"}
        found = {
            one.sensor[-1]
            for one in results
            if one.rule == "alarm of the service" and one.signal and one.sensor.startswith(str(folder))
        }
        assert found == raised


def test_a_position_alone_and_too_few_sensors(tests):
    done = pod(*tests, "--position", "B")
    assert "2 sensors with a wall loss; a POD needs at least 6" in message(done)
    assert {one.sensor[-1] for one in read_runs(tests, "B", None)} == {"B"}


def test_a_repeated_seed_an_empty_folder_and_a_real_rig_are_refused(tests, tmp_path, monkeypatch):
    assert "repeats seed 1" in message(pod(tests[0], tests[0]))
    assert "holds no test that" in message(pod(tmp_path))
    real = SimpleNamespace(rig=SimpleNamespace(on_twin=False), twin=SimpleNamespace(seed=1))
    monkeypatch.setattr("daq_service.cli.offline.pod.runs.restore_settings", lambda _: real)
    assert "has no true loss (a real rig): give a .csv file" in message(pod(tests[0]))


def test_a_configuration_of_another_version_is_refused(tests, monkeypatch):
    def fail(_):
        Settings.model_validate({"unknown": 1})

    monkeypatch.setattr("daq_service.cli.offline.pod.runs.restore_settings", fail)
    assert "holds no test that this version can read" in message(pod(tests[0]))


def test_an_alarm_at_a_sound_wall_is_no_detection():
    def results(loss_mm, at_onset_mm):
        found = summarize_sensor("r", "s", 1e-3 * np.array(loss_mm), 1e-3 * np.array(at_onset_mm))
        return [(round(1e3 * one.loss_m, 6), one.signal) for one in found]

    assert results([0.0, 0.5, 1.0], [0.5, 1.0]) == [(0.0, 0.0), (0.5, 1.0)]
    assert results([0.0, 0.5, 1.0], [0.0, 1.0]) == [(0.0, 1.0), (1.0, 1.0)]
    assert results([0.0, 0.5, 1.0], [0.0]) == [(0.0, 1.0)]
    assert results([0.0, 0.5, 1.0], []) == [(0.0, 0.0), (1.0, 0.0)]
    assert results([0.0, 0.0], []) == [(0.0, 0.0)]
    assert results([0.5, 1.0], []) == [(1.0, 0.0)]
