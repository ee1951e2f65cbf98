"""Poor strikes are repeated, silent transducers retire, a rig that is gone costs sets and not the test."""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from support.small_experiment import disturbed_rig, rows_of, small_settings
from support.small_experiment import run as run_experiment

from daq_service.catalogue import RecorderCatalogue, open_catalogue
from daq_service.catalogue.rows import AlarmRow, SetRow
from daq_service.clock import parse_utc
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    ConnectionLostError,
)
from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import ShotKey
from hardware_drivers.nanoseconds import NS_PER_H

EPOCH_NS = parse_utc("2024-01-01T00:00:00Z")
NO_TRIGGER = "no trigger within 5 s"

Disturb = Callable[[ShotKey, Acquired], Acquired]
Order = tuple[float, str, dict[str, Any]]

run = partial(run_experiment, listen_every_s=0.0)
"""Simulated hours pass in milliseconds: orders are heard at every look."""


def clipped(acquired):
    """Return the same strike at a range that is too small for its incident wave."""
    waveform = acquired.waveform
    low, high = waveform.calibration.full_scale_counts
    counts = np.clip(waveform.counts * (1.1 * high / waveform.counts.max()), low, high)
    return replace(acquired, waveform=replace(waveform, counts=counts.astype(waveform.counts.dtype)))


def untouched(key, acquired):
    return acquired


def silent(position, from_set=0, until_set=10_000):
    """Disturb a position so that nothing triggers."""

    def disturb(key, acquired):
        if key.position == position and from_set <= key.set_index < until_set:
            raise AcquisitionTimeoutError(NO_TRIGGER)
        return acquired

    return disturb


def missed(acquired):
    raise AcquisitionTimeoutError(NO_TRIGGER)


class OrderingClock:
    """Clock of the recorder, with an operator who writes commands at chosen hours of the test.

    Late ones come when the hour is reached: the recorder hears them at its next look.
    """

    def __init__(self, clock, folder, orders, late):
        self._clock = clock
        self._folder = folder
        self._orders = list(orders)
        self._late = late

    def utc_ns(self):
        return self._clock.utc_ns()

    def mono_ns(self):
        return self._clock.mono_ns()

    def wait_until(self, utc_ns, idle):
        reached = self._late and self._clock.wait_until(utc_ns, idle)
        while self._orders and utc_ns >= EPOCH_NS + round(self._orders[0][0] * NS_PER_H):
            _, kind, arguments = self._orders.pop(0)
            with open_catalogue(self._folder) as catalogue:
                catalogue.add_command("ann", kind, arguments)
        return reached if self._late else self._clock.wait_until(utc_ns, idle)


def ordering_rig(folder, orders, disturb=untouched, *, late=False):
    """Return a disturbed twin whose operator gives the commands ``orders``: hour, kind, arguments."""

    @contextmanager
    def opener(settings, clock, epoch_utc_ns):
        with disturbed_rig(disturb)(settings, clock, epoch_utc_ns) as rig:
            yield replace(rig, clock=OrderingClock(rig.clock, folder, orders, late))

    return opener


def sets_of(folder, position):
    with open_catalogue(folder) as catalogue:
        return sorted(catalogue.rows(SetRow, position=position), key=lambda row: row.set_index)


def alarms_of(folder):
    with open_catalogue(folder) as catalogue:
        return {(row.position, row.kind): row for row in catalogue.rows(AlarmRow)}


def only(names, settings):
    """Return settings of these positions only: each costs test time."""
    return settings.model_copy(update={"positions": {name: settings.positions[name] for name in names}})


def two_hours(**tables):
    return small_settings(schedule={"end_h": 2.0}, **tables)


class _KilledError(BaseException):
    """Substitute for SIGKILL, which no code may catch to clean up."""


def test_rows_made_from_an_orphaned_file_are_those_of_the_recorder(tmp_path, monkeypatch):
    """Missed, superseded and lost shots, and the trouble that ended the set: all are in the file."""

    def disturb(key, acquired):
        if key.set_index == 1 and key.attempt == 0 and (key.position, key.shot_index) == ("B", 0):
            raise AcquisitionTimeoutError(NO_TRIGGER)
        if key.set_index == 1 and key.attempt == 0 and (key.position, key.shot_index) == ("B", 1):
            return clipped(acquired)
        if key.set_index == 1 and key.position == "C":
            raise ConnectionLostError("the board does not answer")
        return acquired

    def killing(self, commit):
        if commit.sets and commit.sets[0].set_index == 1:
            raise _KilledError
        return commit_set(self, commit)

    assert run(only("ABC", two_hours()), tmp_path / "whole", rig=disturbed_rig(disturb))
    whole = rows_of(tmp_path / "whole")
    assert {row.kind for row in whole["alarms"]} == {"instruments_unavailable"}
    commit_set = RecorderCatalogue.commit_set
    with monkeypatch.context() as patch:
        patch.setattr(RecorderCatalogue, "commit_set", killing)
        with pytest.raises(_KilledError):
            run(only("ABC", two_hours()), tmp_path / "killed", rig=disturbed_rig(disturb))
    assert run(only("ABC", two_hours()), tmp_path / "killed")
    assert rows_of(tmp_path / "killed") == whole


SILENT = {"no_data_sets": 2, "retire_after_sets": 4}


# A rig that is gone or busy --------------------------------------------------------------------


def lost_during(sets, position, times, error):
    """Let the first ``times`` strikes of a position in each set meet a lost connection."""

    def disturb(key, acquired):
        tried.append(key)
        if key.set_index in sets and key.position == position and key.shot_index < times:
            raise error(f"board 01A2B3C4 is gone at {key.position}{key.shot_index}")
        return acquired

    tried: list[ShotKey] = []
    return disturb, tried


FOUR_SHOTS = {"end_h": 2.5, "shots_per_set": 4}


def test_a_long_loss_of_the_rig_disables_no_transducer(tmp_path):
    disturb, _ = lost_during(range(1, 5), "B", 4, ConnectionLostError)
    settings = only("AB", small_settings(schedule={**FOUR_SHOTS, "end_h": 3.0}, quality=SILENT))
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    assert [row.state for row in sets_of(tmp_path, "B")] == ["done"] + ["missed"] * 4 + ["done"]
    assert set(alarms_of(tmp_path)) == {(None, "instruments_unavailable")}


TWO_SHOTS = {"end_h": 2.5, "shots_per_set": 2}


def test_a_rig_that_answers_nothing_in_short_sets_raises_the_alarm(tmp_path):
    """Too few strikes to give the set up, but not one was answered."""
    disturb, _ = lost_during(range(1, 3), "B", 2, ConnectionLostError)
    settings = only("AB", small_settings(schedule=TWO_SHOTS))
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    alarm = alarms_of(tmp_path)[None, "instruments_unavailable"]
    assert (alarm.raised_set_index, alarm.state) == (1, "returned_unacknowledged")
    assert alarm.message == "set 1 got no answer: board 01A2B3C4 is gone at B1; the next set tries again"


def test_one_strike_that_is_answered_is_no_trouble_of_the_rig(tmp_path):
    disturb, _ = lost_during(range(1, 3), "B", 2, ConnectionLostError)
    assert run(small_settings(schedule=TWO_SHOTS), tmp_path, rig=disturbed_rig(disturb))
    assert (None, "instruments_unavailable") not in alarms_of(tmp_path)


@pytest.mark.parametrize("late", [False, True])
def test_a_pause_does_not_report_that_the_rig_is_back(tmp_path, late):
    """Heard while the set is awaited, or when its first record is."""
    disturb, _ = lost_during(range(1, 2), "B", 4, ConnectionLostError)
    rig = ordering_rig(tmp_path, [(1.5, "pause", {"note": "why"})], disturb, late=late)
    assert run(only("AB", small_settings(schedule=FOUR_SHOTS)), tmp_path, rig=rig)
    assert [row.state for row in sets_of(tmp_path, "B")] == ["done"] + ["missed"] * 4
    assert alarms_of(tmp_path)[None, "instruments_unavailable"].state == "unacknowledged"


def test_a_poor_shot_at_the_end_of_a_cut_set_is_counted_as_it_was_struck(tmp_path):
    """The gate grants a repetition, and a hold comes before it: it was never made."""
    orders: list[Order] = [(1.0 + 4 / 3600, "pause", {"note": "door open"})]
    settings = only("B", two_hours())
    assert run(settings, tmp_path, rig=ordering_rig(tmp_path, orders, silent("B", from_set=1)))
    row = sets_of(tmp_path, "B")[1]
    assert (row.state, row.n_missed, row.n_restrikes) == ("missed", 1, 0)
    assert row.reason == f"paused by ann: door open; 1 missed: {NO_TRIGGER}"
