"""Operator guidance: every alarm kind has an entry, and the how-to page shows it."""

import re
from pathlib import Path

import pytest

from daq_service.alarms.clock_trouble import CLOCK_UNVERIFIED
from daq_service.alarms.guidance import GUIDANCE, format_guidance_markdown
from daq_service.alarms.process_trouble import RECORDER_NOT_RUNNING, WEB_NOT_RESPONDING
from daq_service.alarms.states import NOT_ASSESSED
from daq_service.corrosion_drive.drive import CONDITIONS

ROOT = Path(__file__).parents[4]
HOW_TO = ROOT / "docs" / "how-to" / "respond-to-an-alarm.md"
RAISED_IN = ("alarms", "assessment", "commands")


def test_the_how_to_shows_the_table():
    assert format_guidance_markdown() in HOW_TO.read_text(encoding="utf-8"), format_guidance_markdown()


def test_every_raised_kind_has_guidance():
    kinds = {CLOCK_UNVERIFIED, NOT_ASSESSED, RECORDER_NOT_RUNNING, WEB_NOT_RESPONDING}
    for room in RAISED_IN:
        for file in (ROOT / "daq_service" / room).glob("*.py"):
            for condition in re.findall(
                r"Condition\((.*?)present=", file.read_text("utf-8"), flags=re.DOTALL
            ):
                kinds |= set(re.findall(r'kind="(\w+)"', condition))
    kinds |= CONDITIONS.keys()
    assert len(kinds) > 8
    assert kinds <= GUIDANCE.keys()


@pytest.mark.parametrize("kind", GUIDANCE)
def test_each_guidance_has_checks_and_a_contact(kind):
    one = GUIDANCE[kind]
    assert all([one.meaning, one.limitations, one.contact])
    assert one.short.endswith(".")
    assert len(one.checks) == 3
