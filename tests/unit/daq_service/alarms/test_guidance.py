"""Operator guidance: every alarm kind has an entry, and the how-to page shows it."""

import re
from pathlib import Path

import pytest
from pydantic import ValidationError

from daq_service.alarms.guidance import GUIDANCE, name_contact
from daq_service.alarms.process_trouble import CLOCK_UNVERIFIED, RECORDER_NOT_RUNNING, WEB_NOT_RESPONDING
from daq_service.alarms.states import NOT_ASSESSED
from daq_service.corrosion_drive.drive import CONDITIONS
from daq_service.settings.alarm_delays import CONTACTS
from daq_service.settings.tree import Settings

ROOT = Path(__file__).parents[4]
RAISED_IN = ("alarms", "assessment", "commands")


def test_every_raised_kind_has_guidance():
    kinds = {CLOCK_UNVERIFIED, NOT_ASSESSED, RECORDER_NOT_RUNNING, WEB_NOT_RESPONDING}
    for room in RAISED_IN:
        for file in (ROOT / "daq_service" / room).glob("*.py"):
            for condition in re.findall(
                r"Condition\((.*?)present=", file.read_text("utf-8"), flags=re.DOTALL
            ):
                kinds |= {kind for kind in re.findall(r'"(\w+)"', condition) if kind.endswith("_change")}
                kinds |= set(re.findall(r'kind="(\w+)"', condition))
    kinds |= CONDITIONS.keys()
    assert len(kinds) > 8
    assert kinds <= GUIDANCE.keys()


@pytest.mark.parametrize("kind", GUIDANCE)
def test_each_guidance_has_checks_and_a_contact(kind):
    one = GUIDANCE[kind]
    assert all(text.endswith(".") for text in (one.meaning, one.limitations, one.action, one.consequence))
    assert len(one.checks) == 3
    assert one.contact in CONTACTS
    assert name_contact(kind) == f"the person responsible for the {one.contact}"
    assert name_contact(kind, {one.contact: "Ada, 0123"}) == "Ada, 0123"


def test_a_contact_of_an_unknown_responsibility_is_refused():
    with pytest.raises(ValidationError, match="bath is none of wall, rig, computer, cell"):
        Settings(alarms={"contacts": {"bath": "Ada"}})
