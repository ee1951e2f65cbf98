"""`solimon wall`: thickness from feature tables with the shipped bank; refusals."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from analysis.wall.bank import FEATURES, load_bank
from daq_service.assessment.wall_bank import SHIPPED_BANK
from daq_service.cli.main import cli
from daq_service.settings.file import find_config_file
from simulator.errors import SpecimenError

SD = np.array([0.006, 0.03, 0.017, 0.008, 0.05])
CONFIG = str(find_config_file("simulated.toml"))
BASELINE = 48


@pytest.fixture(scope="module")
def bank():
    return load_bank(SHIPPED_BANK)


def write_table(path, bank, losses, *, gain=0.02, factors=(1.0,) * 5, left_out=()):
    """Write sets of a solid plate with these losses after a baseline of a day; return the path as text."""
    random = np.random.default_rng(1)
    member = bank.names.index("solid, square 25.4 mm")
    sets = bank.sound + SD * random.standard_normal((BASELINE + len(losses), 5))
    for k in range(5):
        sets[BASELINE:, k] += np.interp(losses, bank.losses, bank.changes[member][:, k])
    values = np.exp(sets) * np.array(factors) * np.array([1.0, 1.0, 1.0, 1.0, gain])
    hours = np.concatenate([0.5 * np.arange(BASELINE), 24.0 + 12.0 * np.arange(1, len(losses) + 1)])
    names = [name for name in ("due_h", *FEATURES) if name not in left_out]
    rows = [
        dict(zip(("due_h", *FEATURES), (hour, *row), strict=True))
        for hour, row in zip(hours, values, strict=True)
    ]
    lines = [",".join(names), *(",".join(f"{row[name]:.8g}" for name in names) for row in rows)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return str(path)


def run(*words):
    return CliRunner().invoke(cli, ["wall", CONFIG, *words])


def test_a_thinning_wall_has_intervals_a_rate_and_a_date(bank, tmp_path):
    losses = 0.4 * np.arange(1, 21) / 20.0
    table = write_table(tmp_path / "b.csv", bank, losses)
    done = run(table, "--position", "C", "--minimum-m", "0.003", "--json")
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert answer["estimand"].startswith("mean over a disc of 10 mm radius")
    rows = answer["tables"][0]["rows"]
    truth_m = bank.thickness_m * (1.0 - losses)
    within = [
        row["interval_low_m"] <= truth <= row["interval_high_m"]
        for row, truth in zip(rows, truth_m, strict=True)
    ]
    assert sum(within) >= 16, within
    last = rows[-1]
    assert 0.2e-3 < last["interval_high_m"] - last["interval_low_m"] < 2.5e-3
    rate_m_per_s = bank.thickness_m * 0.02 / (12.0 * 3600.0)
    assert rate_m_per_s / 2.5 < last["loss_rate_m_per_s"] < 2.5 * rate_m_per_s
    assert last["below_minimum_probability"] < 0.2
    left_s = (last["thickness_m"] - 3e-3) / last["loss_rate_m_per_s"]
    assert left_s / 2.4 < last["time_to_minimum_s"] < 2.4 * left_s  # step of the rates
    assert last["time_to_minimum_low_s"] < last["time_to_minimum_s"]


def test_beyond_three_quarters_only_the_least_loss_is_stated(bank, tmp_path):
    losses = 0.78 * np.minimum(1.0, np.arange(1, 13) / 8.0)
    table = write_table(tmp_path / "b.csv", bank, losses)
    row = json.loads(run(table, "--json").stdout)["tables"][0]["rows"][-1]
    assert row["thickness_m"] is row["interval_low_m"] is None
    assert row["interval_high_m"] < 0.5 * bank.thickness_m
    lost_mm = 1e3 * (bank.thickness_m - row["interval_high_m"])
    assert row["reason"] == f"at least {lost_mm:.2f} mm lost"
    assert f"hour    168.0  at least {lost_mm:.2f} mm lost" in run(table).stdout


def test_the_text_has_a_line_for_each_set_with_units(bank, tmp_path):
    done = run(write_table(tmp_path / "b.csv", bank, np.zeros(3)), "--minimum-m", "0.004")
    assert done.exit_code == 0, done.output
    first, table, *rows = done.stdout.splitlines()
    assert first.startswith("wall thickness, mean over a disc of 10 mm radius")
    assert table.endswith("(position B, 6.35 mm at the baseline)")
    assert len(rows) == 3
    assert "hour     36.0" in rows[0]
    assert "mm (" in rows[0]
    assert "mm per year, below the minimum: 0%" in rows[0]


@pytest.mark.parametrize(
    ("how", "words", "reason"),
    [
        ({"factors": (1e6, 1.0, 1.0, 1.0, 1.0)}, (), "tof_pp_s of the baseline is"),
        ({"factors": (1.0, 1.0, 1.0, 1.5, 1.0)}, (), "isw_fwhm_s of the baseline is"),
        ({}, ("--baseline-hours", "3"), "a baseline of 7 complete sets"),
        ({}, ("--baseline-hours", "500"), "no set follows the baseline"),
    ],
    ids=["microseconds", "another chain", "short baseline", "no set"],
)
def test_a_baseline_that_cannot_be_used_is_refused_with_the_reason(bank, tmp_path, how, words, reason):
    done = run(write_table(tmp_path / "b.csv", bank, np.zeros(3), **how), *words)
    assert done.exit_code == 0, done.output
    assert f"refused, {reason}" in done.stdout
    assert "mm (" not in done.stdout


def test_a_swapped_transducer_gets_no_number(bank, tmp_path):
    path = tmp_path / "b.csv"
    table = write_table(path, bank, np.zeros(2))
    lines = path.read_text(encoding="utf-8").splitlines()
    columns = lines[0].split(",")
    last = [float(value) for value in lines[-1].split(",")]
    last[columns.index("isw_amplitude_v")] *= 0.4
    last[columns.index("isw_fwhm_s")] *= 1.2
    path.write_text("\n".join([*lines[:-1], ",".join(map(str, last))]), encoding="utf-8")
    rows = json.loads(run(table, "--json").stdout)["tables"][0]["rows"]
    assert rows[0]["thickness_m"] is not None
    assert rows[1]["thickness_m"] is None
    assert "not explained by any wall" in rows[1]["reason"]


def test_a_missing_value_is_named_and_the_next_set_counts(bank, tmp_path):
    path = tmp_path / "b.csv"
    table = write_table(path, bank, np.zeros(3))
    lines = path.read_text(encoding="utf-8").splitlines()
    cells = lines[-2].split(",")
    cells[lines[0].split(",").index("amplitude_ratio")] = ""
    path.write_text("\n".join([*lines[:-2], ",".join(cells), lines[-1]]), encoding="utf-8")
    rows = json.loads(run(table, "--json").stdout)["tables"][0]["rows"]
    assert [row["thickness_m"] is None for row in rows] == [False, True, False]
    assert rows[1]["reason"] == "no value of amplitude_ratio"


def test_a_missing_column_a_minimum_in_mm_or_an_unknown_position_is_an_error(bank, tmp_path):
    table = write_table(tmp_path / "b.csv", bank, np.zeros(3), left_out=("psw_isw_area_ratio",))
    done = run(table)
    assert done.exit_code != 0
    assert "psw_isw_area_ratio" in str(done.exception) + done.output
    done = run(table, "--minimum-m", "6.35")
    assert done.exit_code != 0
    assert "must be below plate.thickness_m = 0.00635 m" in str(done.exception) + done.output
    done = run(table, "--position", "A")
    assert done.exit_code != 0
    assert "none of the transducers B, C, D" in str(done.exception) + done.output


def test_a_chain_that_the_twin_cannot_simulate_is_an_error(bank, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise SpecimenError("the reason")

    monkeypatch.setattr("daq_service.cli.offline.wall.build_bank", fail)
    monkeypatch.setattr("daq_service.cli.offline.wall.open_bank", lambda *_: None)
    done = run(write_table(tmp_path / "b.csv", bank, np.zeros(3)))
    assert done.exit_code != 0
    assert "no wall curves for the chain and plate of B: the reason" in str(done.exception) + done.output
