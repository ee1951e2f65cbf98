"""Charge from current readings: closed forms, gaps, boots, and continuation after a restart."""

import functools
import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scripted_supply import supply_parameters

from daq_service.catalogue.rows import EnvironmentRow
from daq_service.corrosion_drive.charge import (
    Charge,
    Command,
    DriveState,
    compute_elapsed_s,
    integrate_charge,
    restore_drive_state,
)
from hardware_drivers.measurement import Stamp

PARAMETERS = supply_parameters()  # longest gap 30 s


def integrated(times_s, current, longest_s=math.inf):
    pairs = itertools.pairwise(times_s)
    return functools.reduce(
        lambda charge, pair: integrate_charge(
            charge,
            elapsed_s=pair[1] - pair[0],
            first_a=current(pair[0]),
            last_a=current(pair[1]),
            longest_s=longest_s,
        ),
        pairs,
        Charge(),
    )


def test_a_straight_line_is_integrated_exactly():
    charge = integrated([0.0, 1.0, 4.0, 4.5, 10.0], lambda t: 0.2 - 0.01 * t)
    # 0.2 t - 0.005 t^2 at 10 s; the trapezoid rule is exact for a line, up to rounding.
    assert charge.coulomb == pytest.approx(1.5, rel=1e-14)
    assert charge.unknown_s == 0.0


def test_a_long_interval_is_unknown_and_not_integrated():
    charge = integrated([0.0, 10.0, 45.0, 55.0], lambda t: 1.0, longest_s=30.0)
    assert charge == Charge(coulomb=20.0, unknown_s=35.0)
    assert integrated([0.0, 30.0], lambda t: 1.0, longest_s=30.0).unknown_s == 0.0


def test_a_clock_set_back_adds_nothing():
    charge = integrate_charge(Charge(coulomb=5.0), elapsed_s=-7.0, first_a=1.0, last_a=1.0, longest_s=30.0)
    assert charge == Charge(coulomb=5.0)


@given(st.lists(st.floats(0.01, 100.0), min_size=1, max_size=30), st.floats(0.01, 100.0))
def test_every_second_is_either_integrated_or_unknown(steps_s, longest_s):
    times_s = [math.fsum(steps_s[:i]) for i in range(len(steps_s) + 1)]
    charge = integrated(times_s, lambda t: 1.0, longest_s=longest_s)
    assert charge.coulomb + charge.unknown_s == pytest.approx(times_s[-1], rel=1e-12)  # rounding


def stamp(utc_s, mono_s, boot_id):
    return Stamp(utc_ns=round(utc_s * 1e9), mono_ns=round(mono_s * 1e9), boot_id=boot_id)


def test_time_is_monotonic_within_a_boot_and_utc_across():
    before = stamp(1000.0, 50.0, "one")
    assert compute_elapsed_s(before, stamp(9000.0, 60.0, "one")) == 10.0
    assert compute_elapsed_s(before, stamp(1025.0, 3.0, "two")) == 25.0


def row(**changes):
    newest = EnvironmentRow(
        set_index=3,
        due_h=1.5,
        supply_state="on",
        supply_quality="good",
        supply_age_s=4.0,
        charge_coulomb=123.0,
        unknown_s=7.0,
        climate_quality="absent",
    )
    return replace(newest, **changes)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, {"command": Command(), "booked_utc_ns": 96_000_000_000}),
        ({"supply_state": "off"}, {"command": None, "booked_utc_ns": 96_000_000_000}),
        ({"supply_state": "unknown"}, {"command": None, "booked_utc_ns": 96_000_000_000}),
        ({"supply_tripped": "hole at B"}, {"command": None, "booked_utc_ns": 96_000_000_000}),
        # Longer than three intervals: the row counts that time as unknown already.
        ({"supply_age_s": 31.0}, {"command": Command(), "booked_utc_ns": 100_000_000_000}),
        ({"supply_age_s": None}, {"command": Command(), "booked_utc_ns": None}),
    ],
)
def test_a_restart_continues_from_the_newest_row(changes, expected):
    state = restore_drive_state(row(**changes), written_utc_ns=100_000_000_000, parameters=PARAMETERS)
    tripped = changes.get("supply_tripped")
    assert state == DriveState(charge=Charge(coulomb=123.0, unknown_s=7.0), tripped=tripped, **expected)


@pytest.mark.parametrize("newest", [None, row(supply_state="absent", charge_coulomb=None, unknown_s=None)])
def test_without_a_row_of_the_supply_the_charge_starts_at_zero(newest):
    assert restore_drive_state(newest, written_utc_ns=1, parameters=PARAMETERS) == DriveState()
