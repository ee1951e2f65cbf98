"""Every read route of the service on a folder filled through the real catalogue and archive."""

import json
import math
import re
import time
from datetime import UTC, datetime, timedelta

import httpx2
import numpy as np
import pytest
from support.filled_folder import LIMIT_F, filled_folder, frozen_baseline, served_folder
from support.served_web import served

from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import (
    AssessmentRow,
    BaselineRow,
    EnvironmentRow,
    EventRow,
    FeatureRow,
    as_dict,
)
from daq_service.cli.status.command import run_status
from daq_service.clock import TimeLine, boot_name, elapsed_ns
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.supply_state import stamp_state, write_stored_state
from daq_service.processes.data_folder import DRIVE_FILE
from daq_service.processes.heartbeat import FILE_NAME, Heartbeat
from daq_service.settings.tree import Settings
from daq_service.web.answers import models
from daq_service.web.answers.json_answer import (
    add_utc,
    format_hour_as_rfc3339,
    format_hours_as_rfc3339,
    format_rfc3339,
)
from daq_service.web.report.make import build_report_page
from daq_service.web.routes import trends
from hardware_drivers.nanoseconds import NS_PER_H

N_SETS = 60
EPOCH = datetime(2024, 1, 1, tzinfo=UTC)


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), shots_per_set=2) as folder:
        for index in range(N_SETS):
            folder.add_set(index, stored=index in (0, N_SETS - 1), shown=index == N_SETS - 1)
            if index > 1:  # the supply came later
                folder.add_environment(index)
        folder.add_alarm("B", 55)
        folder.add_alarm("C", 50, state="acknowledged", priority="critical", kind="no_reflection")
        yield folder


def get(api, path):
    answer = api.get(path)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_info_names_experiment_rig_clock_and_plan(api, filled):
    info = get(api, "/api/v1/info")
    assert info["name"] == filled.settings.name
    assert (info["rig"], info["rig_label"]) == ("simulated", "physics twin")
    assert info["schedule"] == {"n_sets": 425, "end_h": 350.0, "baseline_h": 24.0, "shots_per_set": 10}
    assert info["clock"]["can_finish_now"] is False
    assert [place["position"] for place in info["positions"]] == ["A", "B", "C", "D"]
    assert info["last_event_id"] == filled.catalogue.last_event_id()


def test_finish_now_is_offered_only_while_a_paced_test_runs(tmp_path):
    with served_folder(tmp_path, Settings(clock={"pace_h_per_s": 5.0}), sets=1) as (filled, api):
        assert get(api, "/api/v1/info")["clock"]["can_finish_now"] is True
        filled.say("schedule_done", filled.due[0].due_utc_ns)
        info = get(api, "/api/v1/info")
        assert (info["clock"]["can_finish_now"], info["as_of"]["recorder"]) == (False, "finished")


def test_a_pace_that_is_not_kept_is_shown(tmp_path):
    with served_folder(tmp_path, Settings(clock={"pace_h_per_s": 5.0}), sets=1) as (_, api):
        assert get(api, "/api/v1/info")["as_of"]["pace_h_per_s"] is None
        Heartbeat(tmp_path, deadline_s=60.0, pace=lambda: 1.25).beat("taking set 1")
        assert get(api, "/api/v1/info")["as_of"]["pace_h_per_s"] == 1.25


def test_ages_are_on_the_experiments_clock_and_since_the_last_write(api, filled):
    last = filled.due[N_SETS - 1]
    answer = get(api, "/api/v1/features?position=B&from_h=10&to_h=10.25")
    (row,) = answer["items"]
    assert answer["as_of"]["now_h"] == last.due_h
    assert row["age_h"] == last.due_h - 10.0
    assert datetime.fromisoformat(row["due_utc"]) == EPOCH + timedelta(hours=10)
    assert 0.0 <= answer["as_of"]["wall_age_s"] < 600.0
    assert row["quality"] == "good"


@pytest.mark.skipif(boot_name() is None, reason="this system names no boot")
@pytest.mark.parametrize(("by_h", "side"), [(400, "ahead of"), (-400, "behind")])
def test_ages_are_on_the_tests_own_time_when_the_computers_clock_was_set(tmp_path, capsys, by_h, side):
    with filled_folder(tmp_path, Settings(clock={"kind": "wall"}), sets=1) as filled:
        now_ns = time.time_ns() - by_h * NS_PER_H  # written before the step
        written = EventRow(
            utc_ns=now_ns, wall_utc_ns=now_ns, topic="service", kind="self_calibrated", payload={}
        )
        filled.catalogue.commit_set(SetCommit(events=[written]))
        filled.beat(line=TimeLine(utc_ns=now_ns, elapsed_ns=elapsed_ns()))
        with served(filled.settings, tmp_path) as service, service.client() as api:
            info = get(api, "/api/v1/info")
    assert info["clock"]["system_ahead_s"] == pytest.approx(by_h * 3600, abs=300.0)
    age = datetime.now(UTC) - datetime.fromisoformat(info["as_of"]["now_utc"])
    assert age.total_seconds() == pytest.approx(by_h * 3600, abs=300.0)
    assert 0.0 <= info["as_of"]["wall_age_s"] < 300.0
    run_status(config=None, data_dir=tmp_path, as_json=False, watch=False)
    pattern = rf"^clock     this computer's is 14\d{{5}} s {side} the test's time$"
    assert re.search(pattern, capsys.readouterr().out, re.MULTILINE)


def test_a_number_that_is_not_available_is_null(api):
    (row,) = get(api, "/api/v1/features?position=B&limit=1")["items"]
    assert row["ssw_amplitude_v"] is None


def test_ranges_include_their_start_and_exclude_their_end(api):
    rows = get(api, "/api/v1/features?position=B&from_h=5&to_h=7")["items"]
    assert [row["due_h"] for row in rows] == [5.0, 5.5, 6.0, 6.5]
    sets = get(api, "/api/v1/sets?position=B&from_h=5&to_h=7")["items"]
    assert [row["due_h"] for row in sets] == [5.0, 5.5, 6.0, 6.5]
    assert get(api, "/api/v1/trends/B?from_h=5&to_h=7")["columns"]["due_h"] == [5.0, 5.5, 6.0, 6.5]
    assert get(api, "/api/v1/features?position=B&from_h=5&to_h=5")["items"] == []


@pytest.mark.parametrize(
    ("path", "total"),
    [
        ("/api/v1/sets", 4 * N_SETS),
        ("/api/v1/features?scope=shot", 6 * N_SETS),
        ("/api/v1/environment", N_SETS - 2),
        ("/api/v1/alarms", 2),
    ],
)
def test_pages_together_are_the_whole_listing(api, path, total):
    limit = 1 if total == 2 else 37
    separator = "&" if "?" in path else "?"
    ids, cursor = [], None
    while True:
        page = get(api, f"{path}{separator}limit={limit}" + (f"&cursor={cursor}" if cursor else ""))
        assert len(page["items"]) <= limit
        ids += [row["id"] for row in page["items"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert len(ids) == total
    assert ids == sorted(set(ids))


def test_environment_is_a_row_a_set_with_its_quality_and_age(api, filled):
    (row,) = get(api, "/api/v1/environment?from_h=10&to_h=10.25")["items"]
    (stored,) = filled.catalogue.rows(EnvironmentRow, first_h=10.0, last_h=10.0)
    assert {name: row[name] for name in as_dict(stored)} == as_dict(stored)
    assert (row["voltage_v"], row["charge_coulomb"]) == (10.0, 180.0)
    assert (row["climate_quality"], row["temperature_c"], row["relative_humidity"]) == ("stale", 21.5, None)
    assert (row["due_utc"], row["age_h"]) == ("2024-01-01T10:00:00Z", 20.0)
    latest = get(api, "/api/v1/environment/latest")
    assert (latest["latest"]["set_index"], latest["latest"]["age_h"]) == (N_SETS - 1, 0.0)
    assert latest["as_of"]["now_h"] == 30.0
    assert latest["supply_now"] is None


def test_the_supply_state_is_that_of_its_process_with_its_age(api, filled):
    write_stored_state(
        filled.folder,
        stamp_state(DriveState(tripped="hole at B"), output="off", age_s=2.0, good_for_s=30.0),
    )
    try:
        now = get(api, "/api/v1/environment/latest")["supply_now"]
    finally:
        (filled.folder / DRIVE_FILE).unlink()
    assert models.SupplyNow.model_validate(now)
    assert now.pop("age_s") >= 2.0
    assert now.pop("written_age_s") >= 0.0
    assert now == {
        "state": "unknown",
        "quality": "no_communication",
        "last": "off",
        "tripped": "hole at B",
        "watchdog_trip": False,
        "switch_off_pending": False,
        "process": False,
    }


def test_without_supply_and_probe_the_environment_is_empty(tmp_path):
    with served_folder(tmp_path, sets=1) as (_filled, api):
        assert get(api, "/api/v1/environment")["items"] == []
        assert get(api, "/api/v1/environment/latest")["latest"] is None


def test_info_shows_a_pause_and_a_dry_run(tmp_path):
    with served_folder(tmp_path, sets=1) as (filled, api):

        def pause_and_dry_run():
            info = get(api, "/api/v1/info")
            return info["paused"], info["dry_run"]

        assert pause_and_dry_run() == (None, None), "a recorder of an older version does not say"
        filled.say("recorder_started", dry_run=True)
        filled.say("pause", paused="paused by ann: door open", author="ann")
        assert pause_and_dry_run() == ("paused by ann: door open", True)
        filled.say("recorder_started", dry_run=False)
        assert pause_and_dry_run() == ("paused by ann: door open", False), "a restart ends no hold"
        filled.say("resume", paused="", author="ann")
        assert pause_and_dry_run() == (None, False)


def test_trend_columns_are_the_catalogues_rows(api, filled):
    trend = get(api, "/api/v1/trends/B")
    rows = filled.catalogue.rows(FeatureRow, position="B", scope="set")
    assessments = filled.catalogue.rows(AssessmentRow, position="B")
    columns = trend["columns"]
    assert {len(column) for column in columns.values()} == {N_SETS}
    assert columns["tof_pp_s"] == [row.tof_pp_s for row in rows]
    assert columns["distance_squared"] == [row.distance_squared for row in assessments]
    assert columns["outlier"] == [row.outlier for row in assessments]
    assert trend["units"]["tof_pp_s"] == "s"
    assert trend["units"]["psw_area_v_s"] == "V s"
    assert trend["units"]["amplitude_ratio"] == "1"


def test_a_trend_with_more_sets_than_points_has_bins(api):
    whole, trend = (get(api, f"/api/v1/trends/B{asked}") for asked in ("", "?points=8"))
    models.Trend.model_validate(trend, strict=True)
    assert (whole["bin_sets"], whole["bins"]) == (1, None)
    width, columns, bins = trend["bin_sets"], trend["columns"], trend["bins"]
    assert width == 8
    assert columns.keys() == whole["columns"].keys()
    assert columns["set_index"] == list(range(0, N_SETS, width))
    assert sum(bins["n_sets"]) == N_SETS
    for name in ("tof_pp_s", "distance_squared"):
        for number, first in enumerate(columns["set_index"]):
            values = [v for v in whole["columns"][name][first : first + width] if v is not None]
            assert bins["count"][name][number] == len(values)
            assert bins["minimum"][name][number] == min(values, default=None)
            assert bins["maximum"][name][number] == max(values, default=None)
            # A sum in another order.
            assert columns[name][number] == (pytest.approx(np.mean(values), rel=1e-14) if values else None)
    outliers = [index for index, beyond in enumerate(whole["columns"]["outlier"]) if beyond]
    first_outliers = {index for index in bins["first_outlier_set_index"] if index is not None}
    assert sum(bins["n_outliers"]) == len(outliers)
    assert first_outliers == {
        min(i for i in outliers if i // width == of) for of in {i // width for i in outliers}
    }
    assert {i for i in bins["first_alarm_set_index"] if i is not None} == {55}
    narrow = get(api, f"/api/v1/trends/B?points=8&from_h={whole['columns']['due_h'][50]}&to_h=29")
    assert (narrow["bin_sets"], narrow["columns"]["set_index"][0]) == (1, 50)


@pytest.mark.parametrize("query", ["", "?fields=tof_pp_s,outlier", "?points=30", "?fields=reason"])
def test_no_trend_exceeds_its_size_limit(api, monkeypatch, query):
    monkeypatch.setattr(trends, "MOST_BYTES", 6000)
    trend = get(api, f"/api/v1/trends/B{query}")
    length = len(json.dumps([trend["columns"], trend["bins"]], separators=(",", ":")))
    assert 1200 < length <= 6000  # bins double their width: half of it may stay free
    assert trend["bin_sets"] > 1


def test_trend_gives_the_chosen_fields_only(api):
    columns = get(api, "/api/v1/trends/A?fields=thickness_m")["columns"]
    assert set(columns) == {"set_index", "due_h", "due_utc", "age_h", "quality", "thickness_m"}


def test_standard_errors_are_those_of_the_shots_of_each_set(api, filled):
    columns = get(api, "/api/v1/trends/B?fields=tof_pp_s,standard_error_tof_pp_s")["columns"]
    rows = filled.catalogue.rows(FeatureRow, position="B", scope="shot")
    shots = np.reshape([row.tof_pp_s for row in rows], (N_SETS, -1))
    expected = shots.std(axis=1, ddof=1) / math.sqrt(shots.shape[1])
    np.testing.assert_allclose(columns["standard_error_tof_pp_s"], expected, rtol=1e-9)
    items = get(api, "/api/v1/features?position=B&limit=1000")["items"]
    np.testing.assert_array_equal(
        [item["standard_error"]["tof_pp_s"] for item in items], columns["standard_error_tof_pp_s"]
    )
    assert get(api, "/api/v1/features?position=B&scope=shot")["items"][0]["standard_error"] is None
    bins = get(api, "/api/v1/trends/B?points=8&fields=standard_error_tof_pp_s")["columns"]
    assert set(bins["standard_error_tof_pp_s"]) == {None}
    problem = api.get("/api/v1/trends/A?fields=standard_error_tof_pp_s")
    assert problem.status_code == 422


def test_fit_is_the_least_squares_parabola(api, filled):
    fit = get(api, "/api/v1/fits/B?field=tof_pp_s")
    rows = filled.catalogue.rows(FeatureRow, position="B", scope="set")
    hours, values = [row.due_h for row in rows], [row.tof_pp_s for row in rows]
    expected = np.polynomial.Polynomial.fit(hours, values, 2).convert().coef
    at = np.array([0.0, 15.0, 30.0])
    # Two orthogonalisations of the same problem: their values differ by rounding only.
    np.testing.assert_allclose(
        np.polynomial.polynomial.polyval(at, fit["coefficients"]),
        np.polynomial.polynomial.polyval(at, expected),
        rtol=1e-10,
    )
    assert (fit["n"], fit["from_h"], fit["to_h"]) == (N_SETS, 0.5, 30.0)


def test_a_fit_of_too_few_sets_has_a_reason(api):
    fit = get(api, "/api/v1/fits/B?field=tof_pp_s&to_h=1.6")
    assert fit["coefficients"] is None
    assert "3 points" in fit["reason"]


def test_transducers_have_their_state(api):
    states = {row["position"]: row for row in get(api, "/api/v1/transducers")["items"]}
    assert {name: row["state"] for name, row in states.items()} == {
        "A": "normal",
        "B": "alarm",
        "C": "disabled",
        "D": "normal",
    }
    assert states["C"]["highest_priority"] == "critical"
    assert states["B"]["last_assessment"]["quality"] == "good"
    assert states["B"]["last_assessment"]["limit_f_predictive"] == LIMIT_F
    assert not any(row["stale"] for row in states.values())
    assert states["B"]["last_set"]["set_index"] == N_SETS - 1


def test_data_of_a_missing_recorder_are_stale(tmp_path):
    with filled_folder(tmp_path, sets=1) as filled:
        filled.recorder_ends()
        (tmp_path / FILE_NAME).unlink()
        with served(filled.settings, tmp_path) as service, service.client() as api:
            answer = get(api, "/api/v1/transducers")
            assert answer["as_of"]["recorder"] == "not_responding"
            assert all(row["stale"] for row in answer["items"])


def test_the_evidence_names_its_baseline_on_each_surface(tmp_path):
    with filled_folder(tmp_path, sets=1) as filled:
        for name in ("B", "C"):
            filled.catalogue.commit_set(SetCommit(baselines=[frozen_baseline(name)]))
        by_id = {row.id: row.name for row in filled.catalogue.rows(BaselineRow)}
        (its_id,) = [number for number, name in by_id.items() if name == "C-baseline-1"]
        evidence = {"set_index": 0, "distance_squared": 30.5, "limit": LIMIT_F, "baseline_id": its_id}
        filled.add_alarm("C", 0, evidence=evidence)
        named = "Distance squared of set 0 to C-baseline-1: 30.5, limit 24.3 (1.3 × limit)."
        with served(filled.settings, tmp_path) as service, service.client() as api:
            assert get(api, "/api/v1/alarms/1")["evidence_sentences"][0] == named
            assert named in api.get("/api/v1/tables/alarms?format=csv").text
        assert named in build_report_page(tmp_path).decode()


def test_data_of_a_disabled_transducer_continue_to_age(tmp_path):
    with filled_folder(tmp_path, sets=2) as filled:
        filled.retire("C", 2)
        with served(filled.settings, tmp_path) as service, service.client() as api:
            states = {row["position"]: row for row in get(api, "/api/v1/transducers")["items"]}
        assert (states["C"]["state"], states["C"]["last_set"]["due_h"]) == ("disabled", 1.5)
        assert (states["C"]["data_h"], states["C"]["age_h"]) == (1.0, 0.5)
        assert states["C"]["data_utc"] == "2024-01-01T01:00:00Z"
        assert states["D"]["age_h"] == 0.5
        assert states["C"]["disabled_reason"] == "10 sets running with nothing at C"
        assert states["D"]["disabled_reason"] is None


def test_health_counts_what_is_stored(api):
    health = get(api, "/api/v1/health")
    assert health["counts"]["sets"] == N_SETS
    assert health["counts"]["pulse_echo_records"] == N_SETS
    assert health["counts"]["active_alarms"] == 2
    assert health["recorder"]["state"] == "running"
    assert health["disk_free_bytes"] > 0


def test_alarm_filter_by_activity(api):
    assert len(get(api, "/api/v1/alarms?active=true")["items"]) == 2
    assert get(api, "/api/v1/alarms?active=false")["items"] == []
    alarm = get(api, "/api/v1/alarms/1")
    assert alarm["evidence"]["limit"] == LIMIT_F
    assert alarm["evidence_sentences"][0].endswith(f"30.5, limit {LIMIT_F} (1.3 × limit).")
    assert (alarm["headline"], alarm["response_time_s"]) == (
        "B: signal change, cause undetermined",
        8 * 3600.0,
    )
    assert alarm["action"] == "Compare with the control position, then inspect the wall."


@pytest.mark.parametrize(
    "path",
    [
        "/api/v1/transducers/Z",
        "/api/v1/trends/Z",
        "/api/v1/fits/Z?field=tof_pp_s",
        "/api/v1/sets?position=Z",
        "/api/v1/features?position=..",
        "/api/v1/waveforms/live/Z",
        "/api/v1/waveforms/B/1/0",
        "/api/v1/waveforms/B/0/99",
        "/api/v1/sets/B/400/shots",
        "/api/v1/alarms/99",
        "/api/v1/commands/99",
        "/api/v1/nothing",
        "/static/nothing.js",
    ],
)
def test_an_unknown_item_is_404(api, path):
    # A raw request target: httpx2 would tidy the dots away.
    answer = api.send(httpx2.Request("GET", api.base_url.copy_with(raw_path=path.encode())))
    assert answer.status_code == 404, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    models.ProblemDetails.model_validate_json(answer.content)


# Pure parts


@pytest.mark.parametrize(
    ("utc_ns", "text"),
    [
        (0, "1970-01-01T00:00:00Z"),
        (1_704_067_200_000_000_000, "2024-01-01T00:00:00Z"),
        (1_704_067_200_250_000_000, "2024-01-01T00:00:00.250Z"),
        (1_704_067_200_000_000_001, "2024-01-01T00:00:00.000000001Z"),
        (None, None),
    ],
)
def test_times_lose_no_nanosecond(utc_ns, text):
    assert format_rfc3339(utc_ns) == text


@pytest.mark.parametrize(
    "epoch_utc_ns", [0, -1, 1_700_000_000_000_000_000, 1_700_000_000_250_000_000, 1_700_000_000_000_000_250]
)
def test_times_of_a_column_are_those_of_each_of_its_hours(epoch_utc_ns):
    hours = [-0.5, 0.0, 1.0 / 7200.0, 1.00001, 350.1, 8766.0]
    assert format_hours_as_rfc3339(epoch_utc_ns, hours) == [
        format_hour_as_rfc3339(epoch_utc_ns, hour) for hour in hours
    ]
    assert format_hours_as_rfc3339(epoch_utc_ns, []) == []


def test_rows_with_hours_also_have_utc_times():
    row = add_utc({"due_h": 1.5, "raised_h": None, "wall_utc_ns": 0}, 0)
    assert row == {
        "due_h": 1.5,
        "due_utc": "1970-01-01T01:30:00Z",
        "raised_h": None,
        "raised_utc": None,
        "wall_utc": "1970-01-01T00:00:00Z",
    }


ASKED = {
    "text": "strike C now", "position": "C", "set_index": 3, "shot_index": 6, "attempt": 0, "within_s": 60.0
}  # fmt: skip


def test_info_shows_the_requested_action_and_its_remaining_time(tmp_path):
    with filled_folder(tmp_path, sets=1) as filled:
        at_ns = filled.due[0].due_utc_ns
        with served(filled.settings, tmp_path) as service, service.client() as api:

            def requested_action():
                return get(api, "/api/v1/info")["asked"]

            assert requested_action() is None
            filled.say("asked", at_ns, **ASKED)
            assert requested_action() == {**ASKED, "left_s": 60.0}
            filled.say("orders", at_ns + 45 * 10**9)
            assert requested_action()["left_s"] == 15.0
            filled.say("orders", at_ns + 60 * 10**9)
            assert requested_action() is None, "too late"
            filled.say("asked", at_ns + 61 * 10**9, **ASKED)
            filled.say("asked_over", at_ns + 62 * 10**9)
            assert requested_action() is None, "done"
            filled.say("asked", at_ns + 63 * 10**9, **ASKED)
            filled.recorder_ends()
            assert requested_action() is None, "nobody waits"


def test_info_names_the_instruments_of_a_mixed_rig(tmp_path):
    rig = {
        "kind": "mixed",
        "instruments": {"scope": {"kind": "lab-scope", "range_v": 5.0}, "hammer": {"kind": "lab-hammer"}},
        "positions": {"B": {"digitizer": "scope", "striker": "hammer"}},
    }
    positions = {"B": {"method": "solitary_wave"}}
    with filled_folder(
        tmp_path, Settings(rig=rig, positions=positions, clock={"kind": "wall"}), sets=1
    ) as filled:
        identity = {"scope": "lab-scope, lab-drivers 1.2", "scope.serial_number": "S-77"}
        filled.say("recorder_started", filled.due[0].due_utc_ns, dry_run=False, rig_identity=identity)
        with served(filled.settings, tmp_path) as service, service.client() as api:
            info = get(api, "/api/v1/info")
    assert (info["rig"], info["rig_label"], info["rig_identity"]) == ("mixed", "mixed rig", identity)
    assert info["instruments"] == [
        {"name": "scope", "kind": "lab-scope", "serves": {"digitizer": ["B"]}},
        {"name": "hammer", "kind": "lab-hammer", "serves": {"striker": ["B"]}},
    ]
