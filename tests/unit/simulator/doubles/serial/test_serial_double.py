"""The supply's double is a fair opponent: its load, its protections and its record."""

import pytest

from simulator.doubles.serial.supply import Cell, Supply


@pytest.fixture
def supply():
    supply = Supply(seconds=iter(range(0, 10**6, 3600)).__next__)  # an hour passes with each look
    for command in ("VOLT 10", "CURR 1", "OUTP ON"):
        assert supply.answer(command) is None
    return supply


def test_the_cell_draws_what_its_equation_says():
    cell = Cell(counter_voltage_v=1.5, resistance_ohm=40.0, rise_per_h=1e-3)
    assert cell.operating_point(10.0, 1.0, 0.0) == (10.0, 8.5 / 40.0)
    assert cell.operating_point(10.0, 1.0, 500.0) == (10.0, 8.5 / 60.0)
    assert cell.operating_point(1.0, 1.0, 0.0) == (1.0, 0.0)
    # At its limit of 0.1 A the supply gives 1.5 V + 0.1 A * 40 ohm.
    assert cell.operating_point(10.0, 0.1, 0.0) == (5.5, 0.1)


def test_the_current_drifts_with_time(supply):
    first, second = (float(supply.answer("MEAS:CURR?")) for _ in range(2))
    # One and two hours after the start; seven digits are printed.
    assert first == pytest.approx(8.5 / (40.0 * 1.001), rel=1e-6)
    assert second == pytest.approx(8.5 / (40.0 * 1.002), rel=1e-6)


def noisy_readings(seed):
    supply = Supply(seed=seed, noise_a=1e-3, seconds=lambda: 0.0)
    for command in ("VOLT 10", "CURR 1", "OUTP ON"):
        supply.answer(command)
    return [float(supply.answer("MEAS:CURR?")) for _ in range(400)]


def test_noise_belongs_to_the_seed_and_has_its_size():
    readings = noisy_readings(1)
    assert readings == noisy_readings(1)
    assert readings != noisy_readings(2)
    mean = sum(readings) / 400
    spread = (sum((value - mean) ** 2 for value in readings) / 399) ** 0.5
    assert mean == pytest.approx(8.5 / 40.0, abs=4 * 1e-3 / 20)  # four standard errors of 400 readings
    assert spread == pytest.approx(1e-3, rel=0.15)  # four standard errors: 4 / sqrt(2 * 399)


def test_the_supply_keeps_its_ratings_and_rejects_unknown_commands(supply):
    for command, entry in (
        ("VOLT 31", '-222,"Data out of range"'),
        ("CURR 5.1", '-222,"Data out of range"'),
        ("VOLT ten", '-104,"Data type error"'),
        ("APPL 10,1", '-113,"Undefined header"'),
        ("OUTP MAYBE", '-113,"Undefined header"'),
    ):
        assert supply.answer(command) is None
        assert supply.answer("SYST:ERR?") == entry
        assert supply.answer("SYST:ERR?") == '+0,"No error"'
    assert supply.answer("WHO?") is None
    assert float(supply.answer("VOLT?")) == 10.0


def test_a_tripped_protection_keeps_it_off_until_cleared(supply):
    supply.trip("VOLT")
    assert (supply.answer("OUTP?"), supply.answer("VOLT:PROT:TRIP?")) == ("0", "1")
    supply.answer("OUTP ON")
    assert supply.answer("SYST:ERR?") == '-221,"Settings conflict"'
    assert not supply.on
    supply.answer("VOLT:PROT:CLE")
    supply.answer("OUTP ON")
    assert supply.on


def test_the_record_of_the_double_names_who_switched(supply):
    supply.press_output_key(False)
    supply.press_output_key(False)
    supply.answer("OUTP ON")
    supply.brown_out()
    assert [(change.on, change.cause) for change in supply.output] == [
        (True, "command"),
        (False, "front panel"),
        (True, "command"),
        (False, "brown-out"),
    ]
    times = [change.mono_ns for change in supply.output]
    assert times == sorted(times)
    assert float(supply.answer("VOLT?")) == 0.0
