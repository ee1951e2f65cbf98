"""Lifecycle of a baseline."""

import pytest

from daq_service.assessment.baseline_lifecycle import renew
from daq_service.settings.tree import Settings


def try_to_renew(hours, first_set):
    settings = Settings.model_validate({"baseline": {"hours": hours}})
    renew("B", settings, None, first_set=first_set, author="ann", reason="a new sensor", utc_ns=0)


def test_a_baseline_too_short_for_limits_is_rejected():
    with pytest.raises(ValueError, match=r"gives a baseline 14 sets, it needs 15 .*: begin a new test"):
        try_to_renew(7.0, 20)
    try_to_renew(7.5, 20)
