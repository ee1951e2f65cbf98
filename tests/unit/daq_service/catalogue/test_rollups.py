"""Trends and fits from rollup blocks equal those from all rows, for sets of every state."""

import random
from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import delete, func, select
from support.invented_rows import alarm_row, assessment_row, feature_row, set_row
from support.new_experiment import new_catalogue

from analysis.statistics.trend import fit_trend, fit_trend_of_part
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rollups import QUALITIES, list_bin_value_names
from daq_service.catalogue.rows import FeatureRow
from daq_service.catalogue.stored_rows import begin_write
from daq_service.catalogue.tables import sets, trend_blocks
from daq_service.catalogue.trends import (
    compute_trend_part,
    find_trend_differences,
    read_trend_bins,
    rebuild_trends,
)

N_SETS, BASELINE = 330, 48
VALUES = ("tof_pp_s", "amplitude_ratio")


def random_sets(folder, seed):
    """Return sets of one position and their rows: assessed again, late, missed, disabled, without values."""
    chance = random.Random(seed)
    catalogue, rows_by_set, waiting = new_catalogue(folder), {}, []
    disabled = range(200, 240)
    for index in range(N_SETS):
        own = {"position": "B", "set_index": index, "due_h": 0.5 + index / 2}
        state = "disabled" if index in disabled else chance.choice(["done"] * 6 + ["missed"])
        commit, row = SetCommit(), {"state": state, "due_h": own["due_h"], "alarms": 0, "outlier": None}
        commit.sets.append(set_row(**own, state=state))
        if state == "done":
            row |= {
                name: chance.choice([None, *(chance.gauss(5.0, 1.0) for _ in range(5))]) for name in VALUES
            }
            row["quality"] = chance.choice(QUALITIES)
            given = {name: row[name] for name in VALUES}
            commit.features.append(feature_row(**own, **given, quality=row["quality"], n_valid=2))
            row["outlier"] = None if index < BASELINE else chance.random() < 0.02
            row["distance_squared"] = None if index < BASELINE else chance.random()
            commit.assessments.append(assessment(own, row, index < BASELINE))
        if chance.random() < 0.03:
            row["alarms"] = 1
            commit.alarms.append(alarm(index))
        rows_by_set[index] = row
        waiting.append(commit)
        if chance.random() < 0.2:  # a confirmation set, which no trend contains
            waiting.append(confirmation(own | {"unscheduled_index": 1}))
        if index == BASELINE:  # the baseline's own distances are known now
            for number in range(BASELINE):
                if rows_by_set[number]["state"] == "done":
                    rows_by_set[number]["distance_squared"] = chance.random()
                    own = {"position": "B", "set_index": number, "due_h": rows_by_set[number]["due_h"]}
                    waiting[-1].assessments.append(assessment(own, rows_by_set[number], True))
        if chance.random() < 0.8 or index == N_SETS - 1:
            late = chance.random() < 0.3 and index > BASELINE + 5
            for commit in waiting[::-1] if late else waiting:
                catalogue.commit_set(commit)
            waiting = []
    catalogue.commit_set(SetCommit(alarms=[alarm(7)]))
    rows_by_set[7]["alarms"] += 1
    return catalogue, rows_by_set


def assessment(own, row, in_baseline):
    known = {name: row[name] for name in ("distance_squared", "outlier")}
    return assessment_row(**own, **known, in_baseline=in_baseline, limit_f_predictive=24.3)


def confirmation(own):
    values = dict.fromkeys(VALUES, 1e6)
    return SetCommit(
        sets=[set_row(**own)],
        features=[feature_row(**own, **values, quality="bad", n_valid=2)],
        assessments=[assessment(own, {"distance_squared": 1e6, "outlier": True}, False)],
    )


def alarm(index):
    return alarm_row("B", "no_reflection", state="normal", raised_set_index=index)


@pytest.mark.parametrize("seed", range(2))
def test_bins_equal_those_from_all_rows(tmp_path, seed):
    chance = random.Random(seed)
    catalogue, rows_by_set = random_sets(tmp_path, seed)
    with catalogue:
        for _ in range(60):
            first_h, last_h = sorted(chance.uniform(-5.0, 180.0) for _ in range(2))
            points = chance.choice([1, 2, 7, 30, 100])
            rows = {index: row for index, row in rows_by_set.items() if first_h <= row["due_h"] <= last_h}
            found = read_trend_bins(
                catalogue, "B", first_h=first_h, last_h=last_h, points=points, most_bins=points
            )
            if found is None:
                assert sum(row["state"] == "done" for row in rows.values()) <= points
                continue
            width, bins = found
            assert 0 < bins.size <= points
            of = {}
            for index, row in rows.items():
                if row["state"] != "disabled" or row["alarms"]:
                    of.setdefault(index // width, {})
                of.get(index // width, {})[index] = row
            assert [int(first) // width for first in bins["first_set"]] == sorted(of)
            for row_of, found_bin in zip((of[key] for key in sorted(of)), bins, strict=True):
                compare({i: rows[i] for i in rows if i // width == next(iter(row_of)) // width}, found_bin)


def compare(rows, found):
    """Compare one bin with the rows of its sets."""
    assert (found["first_set"], found["last_set"]) == (min(rows), max(rows))
    done = [row for row in rows.values() if row["state"] == "done"]
    assert (found["n_sets"], found["n_missed"]) == (
        len(done), sum(row["state"] == "missed" for row in rows.values()),
    )  # fmt: skip
    outliers = [index for index, row in rows.items() if row["outlier"]]
    assert (found["n_outliers"], found["first_outlier"]) == (len(outliers), min(outliers, default=np.inf))
    alarms = [index for index, row in rows.items() if row["alarms"]]
    n_alarms = sum(row["alarms"] for row in rows.values())
    assert (found["n_alarms"], found["first_alarm"]) == (n_alarms, min(alarms, default=np.inf))
    worst = max((QUALITIES.index(row["quality"]) for row in done), default=-np.inf)
    assert found["worst_quality"] == worst
    for name in (*VALUES, "distance_squared"):
        column = list_bin_value_names(FeatureRow).index(name)
        values = [row[name] for row in done if row[name] is not None]
        assert found["count"][column] == len(values)
        assert found["minimum"][column] == min(values, default=np.inf)
        assert found["maximum"][column] == max(values, default=-np.inf)
        # Sums of at most 330 numbers in another order.
        assert found["sum"][column] == pytest.approx(sum(values), rel=1e-13)


def test_fits_equal_those_from_all_rows(tmp_path):
    catalogue, rows_by_set = random_sets(tmp_path, 5)
    chance = random.Random(5)
    with catalogue:
        for _ in range(20):
            first_h, last_h = sorted((chance.uniform(-5.0, 60.0), chance.uniform(70.0, 180.0)))
            part = compute_trend_part(catalogue, "B", "tof_pp_s", first_h=first_h, last_h=last_h)
            rows = [
                row for row in rows_by_set.values() if first_h <= row["due_h"] <= last_h and "tof_pp_s" in row
            ]
            values = np.array([row["tof_pp_s"] for row in rows], dtype=float)
            whole, trend = fit_trend([row["due_h"] for row in rows], values), fit_trend_of_part(part)
            assert trend.n_points == whole.n_points
            # Two orthogonalisations of the same problem: they differ by rounding only.
            hours = np.array([first_h, last_h])
            np.testing.assert_allclose(trend.at(hours), whole.at(hours), rtol=1e-10)
            assert trend.residual_sd == pytest.approx(whole.residual_sd, rel=1e-10)
        assert compute_trend_part(catalogue, "B", "tof_pp_s", first_h=900.0, last_h=None)["n"] == 0


def test_blocks_depend_on_the_rows_alone_and_a_wrong_one_is_reported(tmp_path):
    catalogue, _ = random_sets(tmp_path, 1)
    with catalogue:
        with begin_write(catalogue._engine) as connection:
            assert list(find_trend_differences(connection)) == []
            kept = connection.execute(trend_blocks.select()).all()
            rebuild_trends(connection)
            assert sorted(connection.execute(trend_blocks.select()).all()) == sorted(kept)
            gone = "B/bins/0000000064/0000000064"
            connection.execute(delete(trend_blocks).where(trend_blocks.c.place == gone))
            found = list(find_trend_differences(connection))
        assert any(gone in line for line in found)
        catalogue.restore_rows([replace(alarm(70), id=99)])  # touches a set of that block
        with catalogue.open_snapshot() as connection:
            assert list(find_trend_differences(connection)) == []


def test_a_block_with_missing_last_sets_is_stored_with_a_later_set(tmp_path):
    with new_catalogue(tmp_path) as catalogue:
        for index in (*range(70), 300):
            catalogue.commit_set(SetCommit(sets=[planned(index)]))
        with catalogue.open_snapshot() as connection:
            assert list(find_trend_differences(connection)) == []


def test_a_corrupt_row_does_not_prevent_the_storage_of_a_set(tmp_path, caplog):
    with new_catalogue(tmp_path) as catalogue:
        for index in range(3):
            catalogue.commit_set(SetCommit(sets=[planned(index)]))
        with begin_write(catalogue._engine) as connection:
            connection.execute(sets.update().where(sets.c.set_index == 1).values(due_h=77.0))
        catalogue.commit_set(SetCommit(sets=[planned(3)]))  # the last one of a block
        with catalogue.open_snapshot() as connection:
            assert connection.execute(select(func.max(sets.c.set_index))).scalar_one() == 3
    assert "trends of B are not brought up to date: row 2 of table sets" in caplog.text


def planned(index):
    return set_row(index, due_h=0.5 * index)
