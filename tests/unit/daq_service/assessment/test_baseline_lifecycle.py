"""Lifecycle of a baseline."""

import pytest

from daq_service.assessment.baseline_lifecycle import renewed
from daq_service.settings.tree import Settings


def renew(hours: float, first_set: int) -> None:
    settings = Settings.model_validate({"baseline": {"hours": hours}})
    renewed("B", settings, None, first_set=first_set, author="ann", because="a new sensor", utc_ns=0)


def test_a_baseline_too_short_for_limits_is_rejected() -> None:
    with pytest.raises(ValueError, match=r"gives a baseline 14 sets, it needs 15 .*: begin a new test"):
        renew(7.0, 20)
    renew(7.5, 20)
