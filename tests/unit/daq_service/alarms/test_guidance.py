"""Guidance of messages: for each kind of alarm that the page of the documentation knows."""

import re
from pathlib import Path

from daq_service.alarms.guidance import GUIDANCE

PAGE = Path(__file__).parents[4] / "docs" / "how-to" / "my-alarm-what-now.md"


def test_each_kind_of_alarm_has_its_guidance():
    kinds = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert sorted(GUIDANCE) == sorted(kinds)
    assert [words for words in GUIDANCE.values() if not words.endswith(".")] == []
