"""The solid plate as a configuration asks for it."""

import json

import pytest
from support.command_line import solimon_here

COARSE = """
[plate]
model = "solid"

[plate.solid]
degree = 3
edge_element = 0.5
contact_element = 1.0
largest_element = 12.0
"""


def simulate(folder, text, *arguments):
    file = folder / "solid.toml"
    file.write_text(text, encoding="utf-8")
    return solimon_here("simulate", str(file), *arguments, env={})


def test_a_configuration_gives_a_shot_on_the_solid(tmp_path):
    done = simulate(tmp_path, COARSE, "--json", "--depth", "0.4")
    assert done.returncode == 0, done.stderr
    shot = json.loads(done.stdout)
    assert shot["energy_residual"] <= 1e-4
    # The usual mesh gives 347.65 us and 0.444; the Mindlin plate 357.2 us and 0.452.
    assert shot["tof_us"] == pytest.approx(347.65, abs=0.5)
    assert shot["amplitude_ratio"] == pytest.approx(0.444, abs=0.004)


def test_a_position_may_have_a_solid_of_its_own(tmp_path):
    text = '[positions.B]\nmethod = "solitary_wave"\nplate = { model = "solid", solid = { degree = 3 } }\n'
    alone = simulate(tmp_path, text, "--json", "--depth", "0.4", "--position", "B")
    assert json.loads(alone.stdout)["tof_us"] == pytest.approx(347.65, abs=0.5)
