"""Text of `solimon status`."""

import re
from dataclasses import replace

import pytest
from support.command_line import solimon_here
from support.filled_folder import LIMIT_CHART, LIMIT_F, N_BASELINE, FilledFolder, frozen_baseline
from support.invented_rows import set_row

from daq_service.catalogue import SetCommit
from daq_service.cli.status.command import PIPE_COLUMNS
from daq_service.cli.status.facts import GAPS_A_POSITION, describe_status
from daq_service.cli.status.table import compose_status
from daq_service.cli.terminal import create_console
from daq_service.processes.disk_policy import LEVELS
from daq_service.settings.tree import Settings
from daq_service.web.report.make import build_report_page

SETS = N_BASELINE + 2


@pytest.fixture
def filled(tmp_path):
    """Return a running test that has one set after its baseline."""
    folder = FilledFolder(tmp_path, Settings())
    for index in (0, N_BASELINE - 1, N_BASELINE, SETS - 1):
        folder.add_set(index, stored=False)
    yield folder
    folder.close()


def store_missed_set(filled, index, reason, *positions, state="missed"):
    """Store the rows of a missed or incomplete set."""
    due = filled.due[index]
    stored = {"due_utc_ns": due.due_utc_ns, "due_h": due.due_h, "state": state, "reason": reason}
    names = positions or filled.settings.positions
    filled.catalogue.commit_set(SetCommit(sets=[set_row(index, name, **stored) for name in names]))


def status_lines(facts):
    console = create_console("stdout")
    console.width = PIPE_COLUMNS
    with console.capture() as captured:
        console.print(compose_status(facts, "here"))
    return [line.rstrip() for line in captured.get().splitlines()]


def status_of(filled):
    return status_lines(describe_status(filled.folder, filled.settings))


def line_of(lines, word):
    (found,) = [line for line in lines if line.startswith(word)]
    return re.sub(r"  +", "  ", found)


def test_each_result_has_its_limit_quality_and_age(filled):
    facts = describe_status(filled.folder, filled.settings)
    lines = status_lines(facts)
    word = facts["positions"]["B"]
    assert word["state"] == "normal"
    assert word["age_h"] == pytest.approx(0.0, abs=1e-9)
    feature, assessment = word["last_feature"], word["last_assessment"]
    distance, chart = assessment["distance_squared"], assessment["mewma_statistic"]
    assert word["chart"] == {"statistic": chart, "limit": LIMIT_CHART}
    waves = f"ToF {1e6 * feature['tof_pp_s']:.1f} us, AR {feature['amplitude_ratio']:.3f}"
    waves += ", wall 6.35 mm (6.03 to 6.35)"
    rest = f"good, n = 1  0 s  {SETS - 1} done"
    assert line_of(lines, " B") == (
        f" B  normal  D² {distance:.1f}, {waves}  {LIMIT_F}  {chart:.1f} of {LIMIT_CHART}  {rest}"
    )
    assert line_of(lines, "rule").startswith("rule  control chart or diagnosis WALL;")
    by_sets = filled.settings.model_copy(
        update={"alarms": filled.settings.alarms.model_copy(update={"decides_by": "k_of_n"})}
    )
    facts_by_sets = describe_status(filled.folder, by_sets)
    assert facts_by_sets["positions"]["B"]["chart"] is None
    lines_by_sets = status_lines(facts_by_sets)
    assert line_of(lines_by_sets, " B") == f" B  normal  D² {distance:.1f}, {waves}  {LIMIT_F}  -  {rest}"
    assert not any(line.startswith("rule") for line in lines_by_sets)
    wall_m = facts["positions"]["A"]["last_thickness"]["thickness_m"]
    reading = f"{1e3 * wall_m:.2f} mm ({1e3 * wall_m - 0.01:.2f} to {1e3 * wall_m + 0.02:.2f})"
    assert line_of(lines, " A").startswith(f" A  normal  {reading}  5.71 mm  -  good  0 s")


def test_a_diagnosis_other_than_ok_has_its_own_line(filled):
    facts = describe_status(filled.folder, filled.settings)
    assert not any(line.startswith("result") for line in status_lines(facts))
    experiment_text = {"sentence": "the wave has changed", "action": "inspect"}
    for name, cause, probability in (("B", "wall", 0.97), ("C", "undetermined", 0.98), ("D", "ok", 0.9)):
        facts["positions"][name]["last_assessment"] |= {
            "diagnosis": cause,
            "diagnosis_probability": probability,
            "diagnosis_details": experiment_text,
        }
    lines = [re.sub(r"  +", "  ", line) for line in status_lines(facts) if line.startswith("result")]
    assert lines == [
        f"result  B, set {SETS - 1}: WALL (model: 97 %): the wave has changed; inspect",
        f"result  C, set {SETS - 1}: UNDETERMINED: the wave has changed; inspect",
    ]


def test_a_distance_of_another_set_is_not_shown_with_these_features(filled):
    filled.add_set(SETS, stored=False, assessed=False)
    row = line_of(status_of(filled), " B")
    assert "D²" not in row
    assert f" of {LIMIT_CHART}" not in row
    assert "ToF" in row


def test_data_that_are_older_than_the_cadence_explains_are_stale(filled):
    filled.say("pause", filled.due[SETS + 2].due_utc_ns, paused="paused by ann: door open")
    lines = status_of(filled)
    assert "  90 min STALE  " in line_of(lines, " B")
    assert line_of(lines, "paused") == "paused  by ann: door open; nothing strikes until it is resumed"
    assert line_of(lines, "now").startswith(
        f"now  hour {filled.due[SETS + 2].due_h:.2f} of the test, last written"
    )


def test_status_lists_alarms_with_state_and_age(filled):
    filled.add_alarm("B", N_BASELINE, message="3 of the last 5 sets")
    filled.add_alarm(
        "C", SETS - 1, kind="no_reflection", priority="critical", state="acknowledged", message="a hole"
    )
    lines = status_of(filled)
    assert line_of(lines, "alarms") == "alarms  2"
    assert line_of(lines, " 1") == " 1  high  B  unacknowledged  30 min  3 of the last 5 sets"
    assert line_of(lines, " 2") == " 2  critical  C  acknowledged  0 s  a hole"
    assert line_of(lines, " B").startswith(" B  alarm")
    assert line_of(lines, " C").startswith(" C  disabled")
    assert line_of(lines, "Checks, wall change: 1. Does the control position change")
    filled.shelve(1, "a known leak", for_h=8.0)
    lines = status_of(filled)
    assert line_of(lines, "alarms") == "alarms  1, 1 shelved or out of service"
    assert "shelved until 2024-01-" in line_of(lines, " 1")
    assert "by ann: a known leak" in line_of(lines, " 1")
    assert line_of(lines, " B").startswith(" B  shelved")


def test_gaps_are_named_with_their_cause_neighbours_together(filled):
    for index in range(SETS, SETS + 3):
        store_missed_set(filled, index, "paused by ann")
    store_missed_set(filled, SETS + 3, "no trigger", "D")
    hour = f"hour {filled.due[SETS + 2].due_h:g}"
    lines = [re.sub(r"  +", "  ", line) for line in status_of(filled) if line.startswith("gap")]
    assert lines == [
        f"gap  3 sets, {SETS} to {SETS + 2}, missed at A, B, C, D, {hour}: paused by ann",
        f"gap  set {SETS + 3} missed at D, hour {filled.due[SETS + 3].due_h:g}: no trigger",
    ]
    for index in range(SETS + 4, SETS + 14):
        store_missed_set(filled, index, f"cause {index}", "D")
    facts = describe_status(filled.folder, filled.settings)
    assert [gap["set_index"] for gap in facts["gaps"]] == list(range(SETS + 14 - GAPS_A_POSITION, SETS + 14))


def test_status_lists_open_commands_and_the_due_set(filled):
    order = filled.catalogue.add_command("ann", "disable", {"position": "C", "note": ""}, within_s=3600.0)
    expired = filled.catalogue.add_command("bob", "pause", {"note": ""}, within_s=0.0)
    facts = describe_status(filled.folder, filled.settings)
    assert [row["id"] for row in facts["orders"]] == [order], f"order {expired} has expired"
    awaited = [line for line in status_lines(facts) if line.startswith(("waiting", "next"))]
    assert re.fullmatch(
        r"waiting +for the recorder's answer to disable by ann \(pending, expires in 60 min\)", awaited[0]
    )
    # By the count of sets, of which four have rows here.
    assert re.fullmatch(r"next +set 4, due at hour 2\.5, 22\.5 h ago", awaited[1])


@pytest.mark.parametrize(
    ("level", "message"), [("ample", "free,"), ("warn", "free; low,"), ("stop", "nothing more")]
)
def test_status_shows_the_disk_forecast(filled, level, message):
    facts = describe_status(filled.folder, filled.settings)
    disk = {"free_bytes": 5 * 10**9, "level": level, "needed_bytes": 7 * 10**9, "full_at_h": 200.0}
    assert level in LEVELS
    line = line_of(status_lines({**facts, "disk": disk}), "disk")
    assert line.startswith("disk  5.00 GB free")
    assert message in line
    assert line.endswith("about 7.00 GB still to come: full at hour 200")


def test_status_shows_the_result_of_the_last_confirmation_set(filled):
    facts = describe_status(filled.folder, filled.settings)["confirmations"]
    assert facts == {"sets": 0, "last": None, "left_today": {"B": 2, "C": 2, "D": 2}}
    set_key = filled.add_confirmation("C", SETS - 1, authors=("", "ann"))
    facts = describe_status(filled.folder, filled.settings)
    experiment_text = facts["confirmations"]
    assert experiment_text["left_today"] == {"B": 2, "C": 1, "D": 2}, "a person's are not counted"
    assert (
        experiment_text["sets"],
        experiment_text["last"]["position"],
        experiment_text["last"]["confirms"],
    ) == (1, "C", True)
    last = experiment_text["last"]
    assert ((last["set_index"], last["unscheduled_index"]), last["age_h"]) == (set_key, 0.0)
    assert line_of(status_lines(facts), "confirm") == (
        "confirm  1 confirmation sets; left today: B 2, C 1, D 2. The last was at C. "
        "Confirmed by the set of 2024-01-02T01:01:00Z (hour 25.02), distance squared 400, above the limit of "
        "24.3: it agrees with the scheduled sets before it."
    )


def test_status_shows_the_quality_of_each_baseline(filled):
    promised = {"false_alarms_per_sensor_year": 0.2, "rate_verified": True, "rate_not_verified_reason": None}
    short = {
        **promised,
        "rate_verified": False,
        "rate_not_verified_reason": "48 sets, 150 needed",
    }
    doubtful = promised | {
        "named": [{"kind": "outlier", "set_indices": [6]}, {"kind": "trend", "set_indices": [0, 1, 2]}]
    }
    for name, baseline_quality in (("B", short), ("C", short), ("D", doubtful)):
        filled.catalogue.commit_set(
            SetCommit(baselines=[frozen_baseline(name, baseline_quality=baseline_quality)])
        )
    facts = describe_status(filled.folder, filled.settings)
    assert facts["positions"]["A"]["baseline"] is None
    baseline_of_b = {"name": "B-baseline-1", "n_sets": N_BASELINE, "state": "approved", "limit_reason": None}
    assert facts["positions"]["B"]["baseline"] == baseline_of_b | short | {"doubts": []}
    lines = [re.sub(r"  +", "  ", line) for line in status_lines(facts) if line.startswith("baseline")]
    assert lines == [
        "baseline  B, C: 0.2 false alarms per transducer-year, not verified: 48 sets, 150 needed",
        "baseline  D: QUESTIONABLE: set 6 is an outlier; a trend over the complete baseline",
        "baseline  D: 0.2 false alarms per transducer-year, verified",
    ]


def test_a_transducer_whose_baseline_has_no_limits_is_not_assessed(tmp_path):
    filled = FilledFolder(tmp_path, Settings())
    filled.add_set(0, stored=False, assessed=False)
    reason = "a baseline of 14 sets; it needs 15"
    nothing = {"limit_f_predictive": None, "distance_squared": None, "outlier": None, "reason": reason}
    filled.catalogue.commit_set(
        SetCommit(
            baselines=[
                frozen_baseline(
                    "D", state="proposed", limit_f_predictive=None, limits=None, limit_reason=reason
                )
            ],
            assessments=[replace(filled.assessment("D", 0, 0.5), **nothing, limits=None, in_baseline=False)],
        )
    )
    lines = status_of(filled)
    assert line_of(lines, " D").startswith(" D  not assessed  ToF ")
    assert "  none  -  good, n = 1  " in line_of(lines, " D")
    assert line_of(lines, "baseline") == f"baseline  D: NOT ASSESSED: {reason}"
    page = build_report_page(tmp_path).decode()
    assert f"<p>Not assessed: {reason}.</p>" in page
    filled.close()


def test_status_shows_a_missing_file_and_a_tripped_supply(filled):
    facts = describe_status(filled.folder, filled.settings)
    supply = {"quality": "good", "tripped": "a hole", "description": "off; tripped: a hole"}
    lines = status_lines({**facts, "lost": {"sets/set_000001.h5": "is empty"}, "supply": supply})
    assert line_of(lines, "MISSING").startswith(
        "MISSING  sets/set_000001.h5 is empty; solimon repair --from BACKUP"
    )
    assert line_of(lines, "supply") == "supply  off; tripped: a hole"


def test_a_position_with_a_partial_set_is_not_listed_as_missed(filled):
    store_missed_set(filled, SETS, "a stop", "B", state="partial")
    store_missed_set(filled, SETS, "a stop", "C", "D")
    at = f"hour {filled.due[SETS].due_h:g}: a stop"
    lines = [re.sub(r"  +", "  ", line) for line in status_of(filled) if line.startswith("gap")]
    assert sorted(lines) == [f"gap  set {SETS} missed at C, D, {at}", f"gap  set {SETS} partial at B, {at}"]


def test_colour_is_for_terminals_without_no_color(filled, monkeypatch):
    facts = describe_status(filled.folder, filled.settings)
    monkeypatch.setenv("TERM", "xterm-256color")
    for variable, coloured in (("FORCE_COLOR", True), ("NO_COLOR", False)):
        monkeypatch.setenv(variable, "1")
        console = create_console("stdout")
        with console.capture() as captured:
            console.print(compose_status(facts, "here"))
        assert ("\x1b[32m" in captured.get()) == coloured


def test_watching_needs_a_terminal(filled):
    for options in (["--watch"], ["--watch", "--json"]):
        done = solimon_here("status", *options, "--data-dir", str(filled.folder), env={})
        assert (done.returncode, done.stdout) == (2, "")
        assert "--watch draws on a terminal" in done.stderr


def test_an_empty_folder_has_no_data_yet(tmp_path):
    lines = status_lines(describe_status(tmp_path, Settings()))
    assert lines == ["data      here", "recorder  never started here", "          no data yet"]


def test_a_position_that_collects_its_baseline_has_no_limit_yet(tmp_path):
    filled = FilledFolder(tmp_path, Settings())
    filled.add_set(0, stored=False, assessed=False)
    row = line_of(status_of(filled), " D")
    assert row.startswith(" D  collecting baseline  ToF ")
    assert "  none yet  -  good, n = 1  " in row
    filled.catalogue.commit_set(
        SetCommit(
            assessments=[
                replace(filled.assessment("D", 0, 0.5), limit_f_predictive=None, distance_squared=12_345.0)
            ]
        )
    )
    assert " D² 1.2e+04, ToF " in line_of(status_of(filled), " D")
    filled.close()
