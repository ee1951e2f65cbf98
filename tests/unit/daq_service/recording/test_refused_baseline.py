"""A baseline without limits: it is not used, and a person renews it."""

import pytest
from support.memory_line import Line, healthy, memory_settings, silent

from daq_service.alarms.transitions import build_transition
from daq_service.catalogue.rows import AssessmentRow, CommandRow
from daq_service.cli.status.facts import describe_status

LAST = 14
REASON = (
    "a baseline of 14 sets; it needs 15 (baseline.minimum_sets); `solimon renew-baseline` begins another one"
)


@pytest.fixture(scope="module", params=["automatic", "by_a_person"])
def line(request, tmp_path_factory):
    """Return a line in which B lacks a set of its baseline and commands arrive during set 16."""
    settings = memory_settings(
        schedule={"phases": [{"until_h": 18.0, "interval_h": 0.5}], "shots_per_set": 1},
        baseline={"hours": 7.5, "minimum_sets": 15, "minimum_valid_shots": 1, "approval": request.param},
    )
    line = Line(tmp_path_factory.mktemp("data"), settings, listen_every_s=0.0)
    orders = {
        ("B", LAST + 2): [("approve_baseline", {"position": "B"}), ("strike", {"position": "B"})],
        ("C", LAST + 2): [("renew_baseline", {"position": "B", "note": "a hold"})],
    }
    line.seen = {}

    def script(key):
        for kind, arguments in orders.pop((key.position, key.set_index), ()):
            line.seen.setdefault(kind, describe_status(line.folder, settings)["positions"]["B"])
            line.order(kind, **arguments)
        return silent("noisy") if (key.position, key.set_index) == ("B", 3) else healthy(key)

    line.script = script
    line.run()
    return line


def test_a_baseline_without_limits_is_not_approved_and_names_the_remedy(line):
    first, second = line.rows("baselines", "B")
    assert (first.state, first.approved_utc_ns, first.limit_reason) == ("retired", None, REASON)
    assert second.limit_reason is None
    frozen = [row.payload for row in line.rows("events", "B") if row.kind == "baseline_frozen"]
    assert frozen[0]["state"] == "proposed", "nobody approves what judges nothing"


def test_a_transducer_with_a_refused_baseline_is_not_assessed(line):
    for status in line.seen.values():
        assert (status["state"], status["last_assessment"]["reason"]) == ("not_assessed", REASON)
        assert status["baseline"]["limit_reason"] == REASON
    assert line.seen.keys() == {"approve_baseline", "strike", "renew_baseline"}


def test_a_baseline_without_limits_is_neither_approved_nor_used(line):
    with line.catalogue() as catalogue:
        answers = {row.kind: (row.state, row.result) for row in catalogue.rows(CommandRow)}
    assert answers["approve_baseline"] == ("rejected", f"the baseline of B has no limits: {REASON}")
    assert answers["strike"][0] == "done"
    with line.catalogue() as catalogue:
        (unscheduled,) = catalogue.rows(AssessmentRow, purpose="confirmation")
    # It is taken after set 16, and the renewal comes with that set.
    assert (unscheduled.set_index, unscheduled.reason) == (LAST + 2, "no baseline yet")
    assert answers["renew_baseline"][0] == "done"


def test_an_alarm_is_active_until_the_baseline_is_retired(line):
    (row,) = line.rows("alarms")
    assert (row.position, row.kind, row.priority, row.raised_set_index) == (
        "B",
        "not_assessed",
        "medium",
        LAST,
    )
    assert row.message.startswith("B: wall not monitored, baseline has no limits. A baseline of 14 sets; it")
    assert row.evidence["reason"] == REASON
    history = [build_transition(event) for event in line.rows("events") if event.topic == "alarms"]
    assert [(event["kind"], event["author"], event["reason"]) for event in history] == [
        ("alarm_raised", None, row.message),
        ("alarm_reset", "Ada", "its baseline was retired: a hold"),
    ]
