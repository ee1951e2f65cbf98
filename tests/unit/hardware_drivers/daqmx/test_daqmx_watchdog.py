"""The X Series watchdog stands over each strike: started before the pulse, asked and stopped after it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from hardware_drivers.daqmx.coil import Coil
from hardware_drivers.errors import AcquisitionTimeoutError


class Recorder:
    """Stands for a vendor object: notes what is asked of it, in order, together with its sibling."""

    def __init__(self, name, notes, *, expired=False):
        self._name, self._notes, self._expired = name, notes, expired

    def __getattr__(self, method):
        def note(*_):
            self._notes.append(f"{self._name}.{method}")

        return note

    @property
    def expired(self):
        self._notes.append(f"{self._name}.expired")
        return self._expired


def coil(notes, *, expired=False):
    return Coil(
        position="B",
        board=SimpleNamespace(label="PXIe-6396 01E18096"),
        task=Recorder("counter", notes),
        watchdog=Recorder("watchdog", notes, expired=expired),
        longest_s=0.01,
    )


def test_it_is_armed_before_the_pulse_and_disarmed_after_it():
    notes = []
    coil(notes).pulse()
    assert notes == [
        "watchdog.start", "counter.start", "counter.wait_until_done", "counter.stop",
        "watchdog.expired", "watchdog.stop",
    ]  # fmt: skip


def test_an_expired_one_is_cleared_and_the_strike_counts_as_missed():
    notes = []
    with pytest.raises(AcquisitionTimeoutError, match=r"expired .* watchdog\.timeout_s"):
        coil(notes, expired=True).pulse()
    assert notes[-3:] == ["watchdog.expired", "watchdog.clear_expiration", "watchdog.stop"]
