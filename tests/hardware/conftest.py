"""Day-one tests on real instruments: what to test is a configuration file named in the environment.

``SOLIMON_TEST_HARDWARE=path/to/laboratory.toml``
    The rig. Without it everything here is skipped.
``SOLIMON_TEST_STRIKE=yes``
    Strikers may be lifted and dropped. No person has hands in the rig.
``SOLIMON_TEST_LOOPBACK=B:ai7``
    The output terminal of B's coil is wired to this analog input of the board that drives it, and the plug of
    the coil drivers is pulled.
``SOLIMON_TEST_LOAD_OHM=100``
    A resistor of so many ohm, 2 W or more, is wired to the supply's output in place of the specimen, and the
    output may be switched on.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from looped_coil import AFTER_S, LOOPBACK_PRETRIGGER, LOOPBACK_RATE_HZ, Loopback

from daq_service.settings.file import load_settings
from hardware_drivers.daqmx.boards import find_boards, normalize_serial
from hardware_drivers.daqmx.connection import Connection

RIG, STRIKE, LOOPBACK = "SOLIMON_TEST_HARDWARE", "SOLIMON_TEST_STRIKE", "SOLIMON_TEST_LOOPBACK"
LOAD = "SOLIMON_TEST_LOAD_OHM"


def pytest_collection_modifyitems(items):
    """Mark every test in this folder."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.hardware)


@pytest.fixture(scope="session")
def rig():
    """Return the rig of the configuration."""
    path = os.environ.get(RIG)
    if not path:
        pytest.skip(f"{RIG} names no configuration of a real rig (docs/how-to/set-up-a-rig.md)")
    return load_settings(Path(path)).rig


@pytest.fixture(scope="session")
def parameters(rig):
    """Return the boards under test; the configuration of a rehearsal is taken for a real one."""
    if rig.daqmx is None:
        pytest.skip(f"{os.environ[RIG]} has no [rig.daqmx]")
    return replace(rig.daqmx, dry_run=False)


@pytest.fixture(scope="session")
def probe_parameters(rig):
    """Return the ultrasonic probes under test."""
    if rig.niscope is None:
        pytest.skip(f"{os.environ[RIG]} has no [rig.niscope]")
    return rig.niscope


@pytest.fixture(scope="session")
def supply_parameters(rig):
    """Return the supply under test."""
    if rig.supply is None:
        pytest.skip(f"{os.environ[RIG]} has no [rig.supply]")
    return rig.supply


@pytest.fixture(scope="session")
def load_ohm():
    """Return the resistance at the output of the supply; naming it permits to energize it."""
    load = os.environ.get(LOAD)
    if not load:
        pytest.skip(f"{LOAD} is not set: nothing is energized (wiring: docs/how-to/set-up-a-rig.md)")
    return float(load)


@pytest.fixture(scope="session")
def may_strike():
    """Skip tests that lift strikers without permission."""
    if os.environ.get(STRIKE) != "yes":
        pytest.skip(f"{STRIKE} is not 'yes': no striker is moved")


@pytest.fixture
def loopback(parameters):
    """Return the coil of a position recorded by its own board."""
    position, _, channel = os.environ.get(LOOPBACK, "").partition(":")
    if not channel:
        pytest.skip(f"{LOOPBACK} is not set, as in B:ai7 (wiring: docs/how-to/set-up-a-rig.md)")
    wiring = parameters.transducers[position]
    looped = replace(
        parameters,
        transducers={
            position: replace(
                wiring,
                board_serial=wiring.coil_serial,
                striker_serial="",
                input=channel,
                range_v=10.0,
                terminal_configuration="default",
                coupling="default",
            )
        },
        sample_rate_hz=LOOPBACK_RATE_HZ,
        pretrigger_samples=LOOPBACK_PRETRIGGER,
        record_samples=LOOPBACK_PRETRIGGER + round((parameters.pulse_s + AFTER_S) * LOOPBACK_RATE_HZ),
        trigger_level_v=1.5,
        trigger_slope="rising",
        watchdog=None,
        watchdogs=None,
        holdoff_s=None,
        ringing_s=0.0,
    )
    connection = Connection(looped)
    try:
        serial = normalize_serial(wiring.coil_serial)
        yield Loopback(
            position=position,
            parameters=looped,
            connection=connection,
            board=find_boards(connection, [serial])[serial],
        )
    finally:
        connection.close()
