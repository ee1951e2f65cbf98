"""Output of `check-config` for a planned test."""

import pytest

from daq_service.cli.doctor.command import run_checks
from daq_service.cli.inspection import print_configuration
from daq_service.settings.file import load_settings

NEEDS = "it needs at least 15, 200 and more are advised"


@pytest.mark.parametrize(
    ("text", "n_sets", "warning"),
    [
        ("", 48, ""),
        ("[baseline]\nhours = 7.5", 15, ""),
        ("[baseline]\nhours = 5.0", 10, "the plan has 425 sets, and baseline.hours = 5 takes 10 "),
        ("[schedule]\nend_h = 24.0", 48, "the plan has 48 sets, and baseline.hours = 24 takes 48 "),
        ("[schedule]\nend_h = 24.5", 48, ""),
        (
            "[baseline]\nminimum_sets = 7\nhours = 7.0",
            14,
            "the plan has 425 sets, and baseline.hours = 7 takes 14 ",
        ),
    ],
)
def test_a_baseline_without_possible_assessments_causes_a_warning(tmp_path, capsys, text, n_sets, warning):
    (tmp_path / "test.toml").write_text(text, encoding="utf-8")
    print_configuration(
        config=tmp_path / "test.toml", data_dir=tmp_path / "data", schema=False, as_json=False
    )
    printed = capsys.readouterr()
    assert f"baseline   {n_sets} sets planned for each transducer; {NEEDS}\n" in printed.out
    whole = f"WARNING: nothing would be judged: {warning}of each transducer; {NEEDS}, and sets behind it\n"
    assert printed.err == (whole if warning else "")


@pytest.mark.parametrize(("due_on", "is_overdue"), [("2020-01-31", True), ("2999-01-31", False)])
def test_an_overdue_calibration_causes_a_warning(tmp_path, capsys, due_on, is_overdue):
    path, positions = tmp_path / "test.toml", '[positions.B]\nmethod = "solitary_wave"\n'
    path.write_text(f"{positions}[positions.B.calibration]\ndue_on = {due_on}", encoding="utf-8")
    print_configuration(config=path, data_dir=tmp_path / "data", schema=False, as_json=False)
    warning = f"WARNING: positions.B.calibration.due_on = {due_on} is over; calibrate the sensor"
    assert (warning in capsys.readouterr().err) is is_overdue
    checks = run_checks(load_settings(path), tmp_path / "data", "", lambda step: None)
    states = [check.state for check in checks if check.name == "sensors: calibration"]
    assert states == ["warn" if is_overdue else "ok"]
