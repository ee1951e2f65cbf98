"""Two boards that drive coils, each with its own watchdog, which guards its strikes."""

from dataclasses import replace

import pytest
from support.daqmx_models import running_brain
from support.daqmx_rig import board, meet, parameters_of, quick_description, take, why_no, wired

from hardware_drivers.daqmx import WatchdogWiring, open_daqmx
from hardware_drivers.errors import AcquisitionTimeoutError
from hardware_drivers.measurement import ShotKey

FIRST = board()
SECOND = replace(FIRST, serial_number=0x0BAD0001, name="PXI1Slot9")
DESCRIPTION = replace(
    quick_description(FIRST, SECOND),
    transducers={"C": wired(FIRST.serial_number, 0), "D": wired(SECOND.serial_number, 1)},
)
TIMEOUT_S = 1.0


def watchdog(serial: int, line: str) -> WatchdogWiring:
    return WatchdogWiring(board_serial=f"{serial:08X}", lines=(line,), timeout_s=TIMEOUT_S)


@pytest.mark.skipif(bool(why_no("library")), reason=why_no("library") or "the double can be built")
def test_each_board_s_own_watchdog_stands_over_its_strikes(monkeypatch: pytest.MonkeyPatch) -> None:
    with running_brain(DESCRIPTION) as doubles:
        meet(doubles, monkeypatch)
        watchdogs = (
            watchdog(FIRST.serial_number, "port2/line4"),
            watchdog(SECOND.serial_number, "port2/line5"),
        )
        with open_daqmx(parameters_of(DESCRIPTION, doubles, watchdogs=watchdogs)) as rig:
            for position, its in (("C", FIRST), ("D", SECOND)):
                key = ShotKey(position=position, set_index=0, shot_index=0)
                assert take(rig, doubles, key).waveform.counts.size
                guards = [name for name in doubles.control.record()["reservations"] if "watchdog" in name]
                assert guards == [f"{its.serial_number}/watchdog"]
            # The second board's own expires over a host that hangs, and says so.
            rig.digitizer.arm(key)
            doubles.control.inject("DAQmxWaitUntilTaskDone", "hang", seconds=1.2 * TIMEOUT_S)
            with pytest.raises(
                AcquisitionTimeoutError, match=f"watchdog of {SECOND.product} 0BAD0001 expired"
            ):
                rig.striker.strike(key)
        assert doubles.control.record()["reservations"] == {}
