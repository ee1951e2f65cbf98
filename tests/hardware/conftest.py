"""Day-one tests on real boards: what to test is a configuration file named in the environment.

``SOLIMON_TEST_HARDWARE=path/to/laboratory.toml``
    The rig. Without it everything here is skipped.
``SOLIMON_TEST_STRIKE=yes``
    Strikers may be lifted and dropped. Nobody has hands in the rig.
``SOLIMON_TEST_LOOPBACK=B:ai7``
    The output terminal of B's coil is wired to this analog input of the board that drives it, and the plug of
    the coil drivers is pulled.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from looped_coil import AFTER_S, LOOPBACK_PRETRIGGER, LOOPBACK_RATE_HZ, Loopback

from daq_service.settings.file import load_settings
from hardware_drivers.daqmx.boards import find_boards, same_serial
from hardware_drivers.daqmx.connection import Connection
from hardware_drivers.daqmx.parameters import DaqmxParameters

RIG, STRIKE, LOOPBACK = "SOLIMON_TEST_HARDWARE", "SOLIMON_TEST_STRIKE", "SOLIMON_TEST_LOOPBACK"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark everything in this folder."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.hardware)


@pytest.fixture(scope="session")
def parameters() -> DaqmxParameters:
    """The boards under test; a rehearsal's configuration is taken for a real one."""
    path = os.environ.get(RIG)
    if not path:
        pytest.skip(f"{RIG} names no configuration of a real rig (docs/how-to/day-one.md)")
    boards = load_settings(Path(path)).rig.daqmx
    if boards is None:
        pytest.skip(f"{path} has no [rig.daqmx]")
    return replace(boards, dry_run=False)


@pytest.fixture(scope="session")
def may_strike() -> None:
    """Skip what lifts strikers unless a person allows it."""
    if os.environ.get(STRIKE) != "yes":
        pytest.skip(f"{STRIKE} is not 'yes': no striker is moved")


@pytest.fixture
def loopback(parameters: DaqmxParameters) -> Iterator[Loopback]:
    """Coil of a position recorded by its own board."""
    position, _, channel = os.environ.get(LOOPBACK, "").partition(":")
    if not channel:
        pytest.skip(f"{LOOPBACK} is not set, as in B:ai7 (docs/how-to/day-one.md says what to wire)")
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
        serial = same_serial(wiring.coil_serial)
        yield Loopback(
            position=position,
            parameters=looped,
            connection=connection,
            board=find_boards(connection, [serial])[serial],
        )
    finally:
        connection.close()
