"""Receivers and rules in the configuration: rejected values, and secrets that no error repeats."""

from typing import get_args

import pytest

from daq_service.alarms.states import PRIORITIES
from daq_service.errors import UsageError
from daq_service.settings.file import validate_settings
from daq_service.settings.notifications import Priority
from daq_service.settings.tree import Settings

DUTY = {"url": "https://alarms.example.org/hook", "secret_file": "duty.secret"}
HIDDEN = "correct-horse-battery-staple"


def settings(path, receiver, **others):
    values = {"notifications": {"receivers": {"duty": receiver}, **others}}
    return validate_settings(values, path / "test.toml")


def test_files_count_from_the_configuration_and_severities_are_those_of_alarms(tmp_path):
    (duty,) = settings(tmp_path, DUTY).notifications.receivers.values()
    assert duty.secret_file == str(tmp_path / "duty.secret")
    assert duty.url == DUTY["url"]
    assert get_args(Priority) == PRIORITIES


def test_receivers_do_not_change_the_configuration_hash(tmp_path):
    assert settings(tmp_path, DUTY).configuration_hash() == Settings().configuration_hash()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"url": "http://alarms.example.org/hook"}, "http:// to alarms.example.org.*plain_http = true"),
        ({"url": f"https://ann:{HIDDEN}@alarms.example.org/"}, "holds a name or a password; take them out"),
        ({"url": "ftp://alarms.example.org/"}, "not a web address"),
        ({"url": "https://alarms.example.org:99999/"}, "it is not an address"),
        ({"url": f"https://alarms.example.org/a\n{HIDDEN}"}, "characters that an address cannot have"),
        ({"url_env": "HOOK"}, "url and url_env of url, url_file, url_env is given; give exactly one"),
        ({"secret_file": ""}, "none of secret_file, secret_env is given"),
        ({"secret_file": "", "secret_env": HIDDEN}, "give the name of a variable, not what it holds"),
        ({"secret_file": "", "secret_env": "SOLIMON_SECRET"}, "begin with SOLIMON_"),
        ({"secret": HIDDEN}, "unknown key; did you mean secret_"),
        ({"kind": "apprise"}, "an address of apprise holds a password"),
        ({"kind": "apprise", "url": "", "url_env": "MAIL"}, "are a webhook.s; take them out"),
        (
            {"kind": "apprise", "url": "", "url_env": "MAIL", "secret_file": "", "heartbeat_s": 3599.0},
            "heartbeat_s = 3599 is below 3600, the minimum for e-mail and chat. Give 3600 or more",
        ),
        ({"heartbeat_s": 1.0}, "greater than or equal to 10"),
    ],
)
def test_a_receiver_that_cannot_work_is_refused_without_repeating_what_it_holds(changed, message, tmp_path):
    with pytest.raises(UsageError, match=message) as refusal:
        settings(tmp_path, DUTY | changed)
    assert HIDDEN not in str(refusal.value)


def test_plain_http_is_accepted_for_this_machine_or_with_plain_http(tmp_path):
    for url, allowed in (("http://127.0.0.1:8000/", False), ("http://alarms.example.org/", True)):
        checked = settings(tmp_path, DUTY | {"url": url, "plain_http": allowed})
        assert checked.notifications.receivers["duty"].url == url


def test_every_kind_of_receiver_can_have_heartbeats_which_are_off_by_default(tmp_path):
    mail = {"kind": "apprise", "url_env": "MAIL"}
    for receiver, wanted in ((DUTY, 10.0), (mail, 3600.0)):
        for given in ({}, {"heartbeat_s": wanted}):
            (checked,) = settings(tmp_path, receiver | given).notifications.receivers.values()
            assert checked.heartbeat_s == given.get("heartbeat_s")


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ({"receivers": ["night"]}, "rule 1 names the receiver 'night'; there are duty"),
        ({"positions": ["Z"]}, "there is no position 'Z'; the positions are A, B, C, D"),
        ({"priority": "urgent"}, "'low', 'medium', 'high' or 'critical'"),
    ],
)
def test_a_rule_with_unknown_names_is_rejected(rule, message, tmp_path):
    with pytest.raises(UsageError, match=message):
        settings(tmp_path, DUTY, rules=[rule])
