"""Selection, delay and restart of notifications, and the effect of an unreachable receiver."""

import logging
from itertools import pairwise

import pytest
from support.reported_alarms import DEAD, DUTY, TAKEN, Bench, notifying

from daq_service.errors import StorageUnavailableError
from daq_service.processes.notifications import messages
from daq_service.processes.notifications.messages import MOST_LISTED
from daq_service.processes.notifications.receiver import MOST_REFUSALS, is_receiver_dead
from daq_service.processes.notifications.webhook import Outcome

AT_ONCE = {"group_s": 0.0}


@pytest.fixture
def make_bench(tmp_path):
    """Return a factory of benches, closed at the end."""
    benches = []

    def make(**rule):
        receivers = {"duty": DUTY | rule.pop("receiver", {}), "night": DUTY}
        rules = rule.pop("rules", [AT_ONCE | rule])
        bench = Bench(tmp_path, notifying(receivers, rules=rules))
        benches.append(bench)
        bench.run()
        return bench

    yield make
    for bench in benches:
        bench.alarms.catalogue.close()


def changes(message):
    return [(item["kind"], item["change"]) for item in message.facts["alarms"]]


# Rules


def test_an_alarm_message_has_units_age_quality_and_guidance(make_bench):
    bench = make_bench()
    evidence = {"set_index": 72, "distance_squared": 41.2, "limit": 24.3, "rule": {"k": 3, "n": 5}}
    event_id = bench.alarms.change(evidence=evidence)
    bench.mono_s += 240.0
    (message,) = bench.run()
    assert message.title == "[HIGH] B: signal change, cause undetermined - test"
    assert message.text == (
        "[HIGH] B: signal change, cause undetermined. Distance squared "
        "41.2, limit 24.3 (hour 36.0). Compare with the control position, then inspect the wall. "
        "Event: raised, 1970-01-02T12:00:00Z, stored 4.0 min ago. First raised at hour 36.0, set 72, quality "
        "unknown. Distance squared of set 72 to the baseline: 41.2, limit 24.3 (1.7 × limit). "
        "Respond within 8.0 h. Contact: the person responsible for the wall."
    )
    assert message.key.endswith(f".duty.{event_id}")
    assert message.facts["priority"] == "high"
    assert message.facts["alarms"][0]["age_s"] == 240.0


@pytest.mark.parametrize(
    ("rule", "is_sent"),
    [
        ({"priority": "critical"}, False),
        ({"priority": "high"}, True),
        ({"positions": ["C"]}, False),
        ({"positions": ["B", "C"]}, True),
        ({"kinds": ["no_reflection"]}, False),
        ({"kinds": ["no_reflection", "wall_change"]}, True),
        ({"receivers": ["night"]}, False),
        ({"rules": [AT_ONCE | {"kinds": ["no_reflection"]}, AT_ONCE]}, True),
    ],
)
def test_a_rule_chooses_by_severity_position_kind_and_receiver(rule, is_sent, make_bench):
    bench = make_bench(**rule)
    bench.alarms.change()
    assert bool(bench.run()) == is_sent
    assert [line.what for _, line in bench.log.read(limit=1)[0]] == ["sent" if is_sent else "passed"]


def test_each_automatic_state_change_of_an_alarm_is_sent(make_bench):
    bench = make_bench()
    for priority, present in (("medium", True), ("high", True), ("high", False), ("high", True)):
        bench.alarms.change(priority=priority, present=present)
    bench.alarms.change("no_reflection", latched=True)
    bench.alarms.reset("no_reflection")
    sent_changes = [change for message in bench.run(1.0) for _, change in changes(message)]
    assert sent_changes == [
        *("raised", "priority raised", "returned to normal", "active again", "raised", "reset"),
    ]


def test_the_return_to_normal_is_not_sent_if_not_configured(make_bench):
    bench = make_bench(returned=False)
    bench.alarms.change()
    bench.run()
    bench.alarms.change(present=False)
    assert bench.run(5.0) == []


def test_an_alarm_that_returns_to_normal_within_its_delay_is_not_sent(make_bench):
    bench = make_bench(delay_s=60.0)
    bench.alarms.change()
    assert bench.run(50.0) == []
    bench.alarms.change(present=False)
    assert bench.run(300.0) == []
    (line,) = bench.log_lines("held_back")
    assert line.event_ids == [1, 2]
    bench.alarms.change()  # it is active again, and stays
    assert bench.run(59.0) == []
    assert [changes(message) for message in bench.run(2.0)] == [[("wall_change", "active again")]]


def test_a_raised_priority_within_a_delay_keeps_the_return_of_a_sent_alarm(make_bench):
    bench = make_bench(delay_s=60.0)
    bench.alarms.change(priority="medium")
    assert len(bench.run(61.0)) == 1
    bench.alarms.change(priority="high")
    bench.alarms.change(priority="high", present=False)
    sent_changes = [change for message in bench.run(120.0) for _, change in changes(message)]
    assert sent_changes == ["returned to normal", "priority raised"]


def test_a_storm_is_one_message_with_its_counts(make_bench):
    bench = make_bench(group_s=10.0)
    for number in range(MOST_LISTED + 5):
        bench.alarms.change(position=f"P{number}", priority="critical" if number == 3 else "medium")
    bench.alarms.change(position="P0", priority="medium", present=False)
    assert bench.run(9.0) == []
    (message,) = bench.run(2.0)
    assert message.title == (
        "[CRITICAL] 26 alarm changes: 1 critical raised, 24 medium raised, 1 medium returned to normal - test"
    )
    assert message.facts["counts"] == {
        "critical raised": 1,
        "medium raised": 24,
        "medium returned to normal": 1,
    }
    assert len(message.facts["alarms"]) == MOST_LISTED
    assert message.facts["not_shown"] == 6
    assert message.text.endswith("And 6 more: 5 medium raised, 1 medium returned to normal.")


# A restart


def test_an_old_folder_s_alarms_are_no_news_to_new_notifications(make_bench, tmp_path):
    bench = make_bench()
    bench.alarms.change()
    bench.log.path.unlink()
    bench.restarted()
    assert bench.run(60.0) == []
    assert bench.line.state.began == (
        "starts at the present, after event 1: these notifications are new to the test; "
        "1 alarms that are already active are not sent"
    )
    bench.alarms.change("no_reflection")
    assert [changes(message) for message in bench.run()] == [[("no_reflection", "raised")]]


def test_an_alarm_that_returned_to_normal_during_a_service_stop_is_not_sent(make_bench):
    bench = make_bench(delay_s=60.0)
    bench.alarms.change()
    bench.run(10.0)
    bench.mono_s += 40.0
    bench.alarms.change(present=False)
    bench.mono_s += 600.0
    bench.restarted()
    assert bench.run(100.0) == []


class Crash(BaseException):
    """End of the process, which no code handles as an error."""


def test_a_crash_at_any_point_loses_nothing_and_repeats_at_most_one_message(tmp_path):
    """The crash is before and after each line of the log and each message in turn."""
    at, is_over = 0, False
    while not is_over:
        folder = tmp_path / str(at)
        folder.mkdir()
        bench = Bench(
            folder, notifying(rules=[{"kinds": ["no_reflection"], "delay_s": 5.0, "group_s": 3.0}, AT_ONCE])
        )
        bench.run()
        left = [at]

        def crashing(act, left=left):
            def acted(one):
                for do in (None, act):
                    done = do(one) if do else None
                    left[0] -= 1
                    if left[0] == -1:
                        raise Crash
                return done

            return acted

        bench.log.append = crashing(bench.log.append)
        bench._send = crashing(bench._send)
        bench.restarted()
        wanted = [bench.alarms.change(kind) for kind in ("no_reflection", "few_valid_shots", "thickness_low")]
        try:
            bench.run(4.0, at_least_s=2.0)
            wanted.append(bench.alarms.change("no_reflection", position="C"))
            bench.run(20.0, at_least_s=3.0)
            is_over = True
        except Crash:
            bench.restarted()
            bench.run(4.0, at_least_s=2.0)
            if len(wanted) == 3:
                wanted.append(bench.alarms.change("no_reflection", position="C"))
            bench.run(20.0, at_least_s=3.0)
        by_key = {
            message.key: [item["event_id"] for item in message.facts["alarms"]] for message in bench.sent
        }
        assert sorted(event_id for event_ids in by_key.values() for event_id in event_ids) == wanted
        assert len(bench.sent) - len(by_key) <= 1
        bench.alarms.catalogue.close()
        at += 1
    assert at > 12


def test_a_message_unlogged_after_a_crash_is_repeated_with_the_same_key(make_bench, monkeypatch):
    bench = make_bench(group_s=10.0)
    bench.alarms.change("no_reflection")
    bench.alarms.change("few_valid_shots")
    monkeypatch.setattr(bench.line, "_close", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        bench.run(10.0)
    bench.restarted()
    bench.alarms.change("thickness_low")  # must not get into the message that may have been delivered
    first, again, other = [*bench.sent, *bench.run(20.0)]
    assert first.key == again.key != other.key
    assert changes(first) == changes(again) == [("no_reflection", "raised"), ("few_valid_shots", "raised")]
    assert changes(other) == [("thickness_low", "raised")]


def test_a_cursor_of_another_catalogue_starts_at_the_present_with_a_note(make_bench):
    bench = make_bench()
    bench.alarms.change()
    bench.run()
    bench.alarms.catalogue.close()
    ahead = Bench(bench.folder, bench.settings)  # a new catalogue under the same log
    ahead.run()
    assert "the catalogue does not have event 1 as it was reported" in ahead.line.state.began
    ahead.mono_s += 7.0  # its event 1 is written at another time
    ahead.alarms.change("no_reflection")
    assert [changes(message) for message in ahead.run()] == [[("no_reflection", "raised")]]
    ahead.alarms.catalogue.close()


def test_a_full_disk_does_not_prevent_notifications(make_bench, monkeypatch, caplog):
    bench = make_bench()
    monkeypatch.setattr(
        "daq_service.processes.notifications.delivery_log.append_line",
        lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")),
    )
    bench.alarms.change("disk_space", position=None, alarm_class="diagnostic")
    assert [changes(message) for message in bench.run(60.0)] == [[("disk_space", "raised")]]
    assert caplog.text.count("a crash would repeat messages") == 1


# A receiver that rejects the message


def test_a_dead_receiver_is_tried_again_with_growing_pauses_and_loses_nothing(make_bench, caplog):
    bench = make_bench()
    bench.outcomes += [DEAD] * 5
    first = bench.alarms.change()
    times_s = []
    while len(bench.sent) < 6:
        count = len(bench.sent)
        pause_s = bench.line.step()
        times_s += [bench.mono_s] if len(bench.sent) > count else []
        bench.mono_s += pause_s
    assert times_s == [0.0, 2.0, 6.0, 14.0, 30.0, 62.0]
    assert len({message.key for message in bench.sent}) == 1
    assert [line.event_ids for line in bench.log_lines("sent")] == [[first]]
    assert [line.result for line in bench.log_lines("failing")] == ["no answer within 15 s"]
    assert [record.levelno for record in caplog.records].count(logging.WARNING) == 1


def test_a_receiver_that_asks_to_wait_is_left_alone_for_so_long(make_bench):
    bench = make_bench()
    bench.outcomes.append(
        Outcome(ok=False, description="the receiver answers 429", status=429, retry_after_s=120.0)
    )
    bench.alarms.change()
    assert len(bench.run(119.0)) == 1
    assert len(bench.run(2.0)) == 1


def test_a_message_that_is_refused_makes_way_for_the_others(make_bench):
    bench = make_bench()
    refusal = Outcome(ok=False, description="the receiver answers 422", status=422, refused=True)
    bench.outcomes += [refusal] * MOST_REFUSALS
    bench.alarms.change()
    bench.run()
    bench.alarms.change("no_reflection")
    bench.run(100.0)
    assert [changes(message)[0][0] for message in bench.sent] == ["wall_change"] * 5 + ["no_reflection"]
    (line,) = bench.log_lines("gave_up")
    assert line.result == "refused 5 times: the receiver answers 422"


def test_a_message_that_is_undelivered_for_a_day_is_given_up_and_logged(make_bench):
    bench = make_bench()
    bench.outcomes += [DEAD] * 400
    bench.alarms.change()
    bench.run(24 * 3600.0 + 600.0, at_least_s=300.0)
    (line,) = bench.log_lines("gave_up")
    assert line.result == "not delivered within 24 h: no answer within 15 s"
    assert is_receiver_dead(bench.line.state, bench.now_ns())
    bench.outcomes.clear()
    bench.alarms.change("no_reflection")
    bench.run(1.0)
    assert not is_receiver_dead(bench.line.state, bench.now_ns())


def test_pending_messages_of_an_unreachable_receiver_are_bounded_and_not_lost(make_bench, monkeypatch):
    monkeypatch.setattr("daq_service.processes.notifications.receiver.MOST_WAITING", 20)
    monkeypatch.setattr("daq_service.processes.notifications.receiver.PAGE_EVENTS", 10)
    bench = make_bench(group_s=1.0)
    bench.outcomes += [DEAD] * 8
    bench.alarms.change()
    bench.run(5.0)
    for number in range(49):
        bench.alarms.change(position=f"P{number}")
    bench.run(100.0)
    assert bench.line.state.waiting == 21
    bench.run(900.0, at_least_s=1.0)
    event_ids = [event_id for line in bench.log_lines("sent") for event_id in line.event_ids]
    assert sorted(event_ids) == list(range(1, 51))


# Heartbeats


def test_a_heartbeat_message_has_recorder_state_and_age_and_stops_with_the_recorder(make_bench, monkeypatch):
    bench = make_bench(receiver={"heartbeat_s": 30.0})
    facts = {
        "recorder": "running",
        "doing": "running, waiting",
        "last_set_age_h": 0.25,
        "last_write_age_s": 9.0,
    }
    monkeypatch.setattr(bench.line._source, "read_heartbeat_facts", lambda: facts)
    (beat,) = bench.run(30.0)
    assert beat.kind == "heartbeat"
    assert beat.text == "Recorder running (running, waiting); last set 15.0 min ago (test time)."
    assert len(bench.run(60.0)) == 2
    facts["recorder"] = "not_responding"
    assert bench.run(300.0) == []
    assert bench.line.state.heartbeat == "withheld"
    assert [line.result.partition(":")[0] for line in bench.log_lines("heartbeat")] == [
        "withheld",
        "ok",
        "withheld",
    ]


def test_heartbeats_to_people_are_one_hour_apart_across_restarts(make_bench, monkeypatch):
    mail = {"kind": "apprise", "url": "", "url_env": "MAIL", "secret_env": "", "heartbeat_s": 3600.0}
    bench = make_bench(receiver=mail)
    facts = {"recorder": "running", "doing": "waiting", "last_set_age_h": 0.25, "last_write_age_s": 9.0}
    sent_s = []
    for pause_s in (1.0, 600.0, 600.0, 3600.0, 1800.0):
        monkeypatch.setattr(bench.restarted()._source, "read_heartbeat_facts", lambda: facts)
        sent_s += [bench.mono_s] * len(bench.run())
        bench.mono_s += pause_s
        sent_s += [bench.mono_s] * len(bench.run())
    assert [round(after - before) for before, after in pairwise(sent_s)] == [4801]


def test_a_temporary_catalogue_error_stops_no_notification(make_bench, monkeypatch):
    bench = make_bench()
    bench.alarms.change()
    with monkeypatch.context() as patch:
        patch.setattr(bench.line._source, "alarm_events", _raise)
        with pytest.raises(StorageUnavailableError):
            bench.line.step()
    assert len(bench.run()) == 1


def _raise(*_):
    raise StorageUnavailableError("the disk is gone")


def test_a_test_message_is_marked_and_moves_no_cursor(make_bench):
    bench = make_bench()
    bench.alarms.change()
    assert bench.line.test("ann") == TAKEN
    (message,) = bench.sent
    assert message.kind == "test"
    assert message.title.startswith("TEST, no alarm")
    assert message.text == "Test message to duty by ann. No action is needed."
    assert len(bench.run()) == 1


def test_no_error_of_a_package_and_no_event_ends_a_receivers_thread(make_bench, monkeypatch, caplog):
    bench = make_bench()
    outcomes = iter([LookupError("mailto://ann:secret@host"), RecursionError(), None])
    send = bench.line._send

    def fail(message):
        error = next(outcomes)
        if error is not None:
            raise error
        return send(message)

    monkeypatch.setattr(bench.line, "_send", fail)
    unreadable, readable = bench.alarms.change("no_reflection"), bench.alarms.change("few_valid_shots")
    read = messages.parse_alarm_change
    monkeypatch.setattr(
        messages, "parse_alarm_change", lambda row: {}["kind"] if row.id == unreadable else read(row)
    )
    assert [changes(message) for message in bench.run(30.0)] == [[("few_valid_shots", "raised")]]
    assert bench.log_lines("sent")[0].event_ids == [readable]
    assert [line.result for line in bench.log_lines("failing")] == ["it could not be sent (LookupError)"]
    assert f"event {unreadable} cannot be read and is not sent" in caplog.text
