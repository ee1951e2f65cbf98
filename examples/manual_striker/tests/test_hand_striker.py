"""Tests of the person as a striker."""

import pytest
from manual_striker.hand import KIND, HandParameters
from pydantic import ValidationError

from hardware_drivers.conformance.bench import MachineClock
from hardware_drivers.kinds import Opening
from hardware_drivers.measurement import ShotKey

KEY = ShotKey(position="C", set_index=0, shot_index=0)


@pytest.fixture
def requests():
    return []


@pytest.fixture
def opening(requests):
    return Opening(clock=MachineClock(), serves={"striker": ("C", "D")}, ask=requests.append)


def test_a_strike_makes_a_request_and_closing_withdraws_it(opening, requests):
    with KIND.open(HandParameters(), opening) as instruments:
        instruments.striker.strike(KEY)
        assert requests == ["strike C now"]
        assert instruments.identity == {"struck_by": "a person"}
    assert requests == ["strike C now", ""]


def test_the_request_uses_the_configured_text(opening, requests):
    with KIND.open(
        HandParameters(words="jetzt {position} anschlagen", who="night shift"), opening
    ) as instruments:
        instruments.striker.strike(KEY)
        assert instruments.identity == {"struck_by": "night shift"}
    assert requests[0] == "jetzt C anschlagen"


@pytest.mark.parametrize("words", ["strike now", "{position} {shot}", "{position.__class__}", "{position"])
def test_a_text_with_unknown_placeholders_is_refused(words):
    with pytest.raises(ValidationError, match="words"):
        HandParameters(words=words)


def test_the_check_reminds_of_the_person_s_part(opening):
    (finding,) = KIND.check(HandParameters(), opening)
    assert finding.state == "warn"
    assert "C, D" in finding.detail
    assert "read_timeout_s" in finding.remedy
