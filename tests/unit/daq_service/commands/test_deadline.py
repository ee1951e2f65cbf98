"""Deadline of a command in boot time, which is independent of UTC steps."""

from dataclasses import replace

import pytest

from daq_service.catalogue.rows import CommandRow
from daq_service.commands.deadline import compute_remaining_s, mark_if_expired

ORDER = CommandRow(
    id=1,
    wall_utc_ns=0,
    author="ann",
    kind="supply_on",
    arguments={},
    state="pending",
    deadline_wall_utc_ns=60 * 10**9,
    deadline_boot_ns=1060 * 10**9,
    boot_id="this",
)


@pytest.mark.parametrize(
    ("boot", "boot_s", "utc_s", "left"),
    [
        ("this", 1000, 0, 60.0),
        ("this", 1061, 1, 0.0),  # UTC was set back meanwhile: it stays expired
        ("this", 1010, 3600, 50.0),  # UTC was set forward, which does not affect the deadline
        ("another", 5, 10, 0.0),  # this computer was started again
        (None, 0, 20, 40.0),  # a system that names no boot
        (None, 0, 60, 0.0),
    ],
)
def test_a_command_is_pending_until_its_deadline_in_this_boot(boot, boot_s, utc_s, left):
    found = compute_remaining_s(ORDER, boot=boot, boot_ns=boot_s * 10**9, wall_utc_ns=utc_s * 10**9)
    assert found == left
    assert mark_if_expired(ORDER, found).state == ("pending" if left else "expired")


def test_a_started_command_does_not_expire():
    started = replace(ORDER, state="started")
    assert mark_if_expired(started, 0.0) is started


def test_a_command_of_an_older_version_has_expired():
    assert (
        compute_remaining_s(replace(ORDER, deadline_boot_ns=None), boot="this", boot_ns=0, wall_utc_ns=0)
        == 0.0
    )
