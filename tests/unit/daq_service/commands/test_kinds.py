"""One definition of each command: its preconditions, with the same messages in web and recorder."""

from dataclasses import replace

import pytest
from pydantic import TypeAdapter, ValidationError
from support.filled_folder import frozen_baseline
from support.invented_rows import alarm_row

from daq_service.catalogue.rows import AnnotationRow
from daq_service.commands.kinds import Command, Facts, StoredCommand
from daq_service.commands.registry import KINDS, AnyCommand, parse_command
from daq_service.errors import UsageError


def facts(**values):
    anything = {
        "can_skip_time": True,
        "paused": "",
        "positions": ("B", "C"),
        "has_supply": True,
        "alarms": (),
    }
    return Facts(**(anything | {"alarms": ()} | values))


def alarm(state, alarm_id=7, position="B", kind="transducer_disabled"):
    return alarm_row(position, kind, id=alarm_id, state=state, message="why")


def order(kind, **arguments):
    return parse_command(kind, "ann", arguments)


ARGUMENTS: dict[str, dict[str, object]] = {
    "acknowledge_alarm": {"alarm_id": 7},
    "pause": {"note": "hands in the rig"},
    "disable": {"position": "B"},
    "enable": {"position": "C"},
    "strike": {"position": "B"},
    "approve_baseline": {"position": "B"},
    "renew_baseline": {"position": "B", "note": "coupled anew"},
    "shelve_alarm": {"alarm_id": 7, "for_h": 8.0, "reason": "known"},
    "unshelve_alarm": {"alarm_id": 9},
    "take_out_of_service": {"alarm_id": 7, "reason": "sensor is being repaired"},
    "return_to_service": {"alarm_id": 10},
    "annotate": {"from_h": 1.0, "position": "A", "text": "couplant renewed"},
    "withdraw_annotation": {"annotation_id": 3},
}
DOUBTED = alarm("unacknowledged", alarm_id=8, position=None, kind="clock_unverified")
NOTED = AnnotationRow(id=3, from_h=1.0, to_h=1.0, text="dropped a spanner", author="ben", written_utc_ns=0)
SHELVED = replace(alarm("acknowledged", alarm_id=9, kind="wall_change"), suppressed="shelved")
OUT_OF_SERVICE = replace(
    alarm("acknowledged", alarm_id=10, kind="thickness_low"), suppressed="out_of_service"
)
OPEN = {
    "alarms": [alarm("unacknowledged", position="C"), DOUBTED, SHELVED, OUT_OF_SERVICE],
    "paused": "",
    "places": ("A", "B", "C"),
    "annotations": [NOTED],
    "baselines": {"B": frozen_baseline("B", state="proposed")},
}


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_permitted_command_is_executed(kind):
    paused = "paused by ben" if kind == "resume" else ""
    assert order(kind, **ARGUMENTS.get(kind, {})).find_refusal(facts(**{**OPEN, "paused": paused})) is None


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize(
    ("state", "word"),
    [
        ({"recorder": "finished"}, "The recorder has finished"),
        ({"recorder": "stopped"}, "The recorder has stopped"),
        ({"recorder": "not_responding", "recorded": False}, "No recorder runs for this test"),
    ],
    ids=["finished", "stopped", "not recorded"],
)
def test_an_ended_recorder_accepts_only_commands_that_change_rows(kind, state, word):
    command = order(kind, **ARGUMENTS.get(kind, {}))
    refusal = command.find_refusal(facts(**OPEN, **state))
    assert (refusal is None) == isinstance(command, StoredCommand)
    assert refusal is None or refusal.detail == f"{word}: no recorder would execute this."


@pytest.mark.parametrize(
    ("kind", "state", "reason", "detail", "hint"),
    [
        (
            "finish_now",
            {"can_skip_time": False},
            "the test runs on the wall clock, which cannot skip time",
            "This test is not paced: it already runs as fast as its clock allows.",
            "finish_now belongs to a simulated clock with clock.pace_h_per_s, as in `solimon demo`.",
        ),
        (
            "pause",
            {"paused": "paused by ben"},
            "the test is already paused by ben",
            "The test is already paused by ben.",
            "Resume it first; a pause has one reason.",
        ),
        (
            "resume",
            {},
            "the test is not paused",
            "The test is not paused.",
            "Only a paused test can be resumed.",
        ),
        (
            "trust_clock",
            {"alarms": [replace(DOUBTED, state="returned_unacknowledged")]},
            "the computer clock is verified",
            "The computer clock is verified.",
            "The alarm clock_unverified is active while it is not.",
        ),
        (
            "disable",
            {"alarms": [alarm("acknowledged")]},
            "B is disabled",
            "B is disabled: why.",
            "Enable it when it is repaired.",
        ),
        (
            "disable",
            {"positions": ()},
            "there is no solitary-wave transducer 'B'; there are: none",
            "There is no solitary-wave transducer 'B'.",
            "There are: none.",
        ),
        (
            "strike",
            {"paused": "paused by ben"},
            "the test is paused by ben",
            "The test is paused by ben.",
            "Resume it when all hands are out of the rig.",
        ),
        (
            "enable",
            {"alarms": [alarm("normal", position="C")]},
            "C is not disabled",
            "C is not disabled.",
            "/api/v1/transducers lists which are, and why.",
        ),
        (
            "supply_on",
            {"has_supply": False},
            "this test has no supply; configure [rig.supply]",
            "This test has no supply.",
            "Configure [rig.supply] and restart the test.",
        ),
        (
            "acknowledge_alarm",
            {"alarms": [alarm("normal")]},
            "alarm 7 is normal: there is nothing to acknowledge",
            "Alarm 7 is normal: there is nothing to acknowledge.",
            "Only alarms that are unacknowledged or returned_unacknowledged wait for an operator.",
        ),
        (
            "acknowledge_alarm",
            {"alarms": [alarm("unacknowledged", alarm_id=6)]},
            "there is no current alarm 7",
            "There is no alarm 7.",
            "/api/v1/alarms lists them.",
        ),
    ],
)
def test_a_rejection_has_the_expected_message(kind, state, reason, detail, hint):
    refusal = order(kind, **ARGUMENTS.get(kind, {})).find_refusal(facts(**state))
    assert (refusal.reason, refusal.detail, refusal.hint) == (reason, detail, hint)
    assert refusal.missing == (reason == "there is no current alarm 7")


def test_every_kind_is_parsed_identically_from_row_and_web():
    web: TypeAdapter[Command] = TypeAdapter(AnyCommand)
    for kind in KINDS:
        body = {"kind": kind, "author": "ann", "arguments": ARGUMENTS.get(kind, {})}
        assert web.validate_python(body) == order(kind, **ARGUMENTS.get(kind, {}))


def test_a_command_without_an_author_does_not_switch_the_supply_on():
    web: TypeAdapter[Command] = TypeAdapter(AnyCommand)
    with pytest.raises(ValidationError, match="author\n  Field required"):
        web.validate_python({"kind": "supply_on"})
    assert web.validate_python({"kind": "supply_off"}).author == "operator"


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        ("jump", {}, "unknown command 'jump'; there are finish_now, stop, acknowledge_alarm, pause, resume"),
        ("disable", {}, "arguments.position: Field required"),
        ("pause", {}, "arguments.note: Field required"),
        ("pause", {"note": " \t"}, "arguments.note: Value error, state why the test is paused"),
        ("pause", {"note": "why", "position": "B"}, "arguments.position: Extra inputs are not permitted"),
        ("supply_on", {"voltage_v": 61.0}, "arguments.voltage_v: Input should be less than or equal to 60"),
        ("supply_on", {"voltage_v": True}, "arguments.voltage_v: Input should be a valid number"),
        ("annotate", {"from_h": "1", "text": "x"}, "arguments.from_h: Input should be a valid number"),
        ("annotate", {"from_h": 1.0, "text": "x" * 2001}, "arguments.text: .*at most 2000 characters"),
        ("annotate", {"from_h": 1e8, "text": "late"}, "arguments.from_h: Input should be less than or equal"),
        ("annotate", {"from_h": 2.0, "to_h": 1.0, "text": "backwards"}, "arguments: Value error"),
        ("acknowledge_alarm", {"alarm_id": True}, "arguments.alarm_id: Input should be a valid integer"),
    ],
)
def test_an_invalid_command_is_rejected_with_the_invalid_part(kind, arguments, message):
    with pytest.raises(UsageError, match=message):
        parse_command(kind, "ann", arguments)
