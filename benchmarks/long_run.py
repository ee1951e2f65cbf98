"""Recorder over 350 or 3,500 simulated hours: memory, open handles and folder size over the sets.

    python benchmarks/long_run.py [--hours 3500] [--folder F] [--json]

The paper's positions and shots on instruments that answer at once with noisy pulses; journal, files,
catalogue, features, assessment and alarms are the real ones. Memory and handles are those of the recorder's
process, sampled every 25 sets; a slope is a line through the samples behind the first fifth, in which
caches fill and the baseline is frozen. Folder: bytes after the last set, and what `check-config` foretold.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from daq_service.cli.forecast import predict_stored_bytes
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder
from daq_service.processes.resource_use import open_handles, resident_bytes
from daq_service.recording.session import record_test
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Acquired, Clock, Echo, Rig
from hardware_drivers.measurement import Calibration, ShotKey, Waveform
from simulator.echo.pulse import build_echo_calibration, simulate_echo

EVERY_SETS = 25
POOL = 97
"""So many different records are made, and given in turn."""


class PooledInstruments:
    """Striker, digitizer and pulse-echo unit in one."""

    def __init__(self, settings: Settings) -> None:
        adc, echo, random = settings.twin.adc, settings.twin.echo, np.random.default_rng(0)
        step_v = adc.range_v / 2.0**15
        calibration = Calibration(
            coefficients_v=np.array([0.0, step_v]), resolution_bits=16, range_v=adc.range_v
        )
        time_s = np.arange(adc.record_samples) / adc.sample_rate_hz
        phases = [np.clip((time_s - at_s) / 178e-6, -0.5, 0.5) for at_s in (150e-6, 490e-6, 660e-6)]
        heights = (2.5, 1.25, 0.2)
        wave = sum(v * np.cos(np.pi * phase) ** 4 for v, phase in zip(heights, phases, strict=True))
        noise = settings.twin.noise.rms_v * random.standard_normal((POOL, adc.record_samples))
        self._shots = [
            Waveform(
                counts=np.rint((wave + one) / step_v).astype(np.int16),
                sample_rate_hz=adc.sample_rate_hz,
                pretrigger_samples=adc.pretrigger_samples,
                calibration=calibration,
            )
            for one in noise
        ]
        receiver = build_echo_calibration(echo)
        self._echo = Waveform(
            counts=np.rint(simulate_echo(6.35e-3, echo) / receiver.coefficients_v[1]).astype(np.int16),
            sample_rate_hz=echo.sample_rate_hz,
            pretrigger_samples=0,
            calibration=receiver,
        )
        self._taken = 0

    def arm(self, key: ShotKey) -> None:
        """Do nothing: nothing is set up."""

    def strike(self, key: ShotKey) -> None:
        """Do nothing: no striker falls."""

    def read(self, timeout_s: float) -> Acquired:
        """Return the next record of the pool, as bytes of its own."""
        self._taken += 1
        found = self._shots[self._taken % POOL]
        return Acquired(
            waveform=Waveform(
                counts=found.counts.copy(),
                sample_rate_hz=found.sample_rate_hz,
                pretrigger_samples=found.pretrigger_samples,
                calibration=found.calibration,
            )
        )

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Return the same echo."""
        return Echo(waveform=self._echo, gain_db=30.0, offset_v=0.0, averages=16)

    def disarm(self) -> None:
        """Do nothing: nothing was armed."""

    def make_safe(self) -> None:
        """Do nothing: nothing is on."""


def sample_process() -> tuple[float, int]:
    """Return resident memory in MB and open handles of this process; on Linux and Windows only."""
    memory, handles = resident_bytes(), open_handles()
    if memory is None or handles is None:
        raise SystemExit("this system tells neither the memory nor the handles of a process")
    return memory / 1e6, handles


def slope_per_1000(sets: list[int], values: list[float]) -> float:
    """Return the slope of a line through the samples after the first fifth."""
    first = len(sets) // 5
    return float(np.polyfit(sets[first:], values[first:], 1)[0] * 1000.0)


def measure(hours: float, folder: Path) -> dict[str, Any]:
    """Record to the end and sample on the way."""
    phases = [{"until_h": 75.0, "interval_h": 0.5}, {"until_h": hours, "interval_h": 1.0}]
    settings = Settings(schedule={"phases": phases})
    samples: list[tuple[int, float, int]] = []

    @contextmanager
    def opened(settings: Settings, clock: Clock, epoch_utc_ns: int) -> Iterator[Rig]:
        instruments = PooledInstruments(settings)
        yield Rig(
            kind="simulated",
            clock=clock,
            striker=instruments,
            digitizer=instruments,
            pulse_echo=instruments,
        )

    def report(event: str, **values: Any) -> None:
        if event == "progress" and values["done"] % EVERY_SETS == 0:
            samples.append((values["done"], *sample_process()))
            print(f"\r{values['done']} of {values['planned']} sets", end="", file=sys.stderr)

    prepare_data_folder(folder)
    with hold_recorder_lock(folder):
        record_test(settings, folder, opened, stop=threading.Event(), report=report)
    print(file=sys.stderr)
    sets = [count for count, *_ in samples]
    memory, handles = [mb for _, mb, _ in samples], [float(number) for *_, number in samples]
    return {
        "sets": sets[-1],
        "memory_mb": {
            "first": memory[0],
            "last": memory[-1],
            "most": max(memory),
            "slope_per_1000_sets": slope_per_1000(sets, memory),
        },
        "handles": {
            "first": handles[0],
            "last": handles[-1],
            "most": max(handles),
            "slope_per_1000_sets": slope_per_1000(sets, handles),
        },
        "folder_bytes": sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()),
        "foretold_bytes": predict_stored_bytes(settings, sets[-1]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--hours", type=float, default=350.0)
    parser.add_argument("--folder", type=Path, help="default: a temporary one")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        facts = measure(options.hours, options.folder or Path(place) / "data")
    if options.json:
        print(json.dumps(facts))
        return
    for name in ("memory_mb", "handles"):
        values = facts[name]
        print(
            f"{name:<10} {values['first']:.1f} first, {values['last']:.1f} last, "
            f"{values['most']:.1f} at most, slope {values['slope_per_1000_sets']:+.2f} per 1,000 sets"
        )
    print(
        f"folder     {facts['folder_bytes'] / 1e9:.3f} GB after {facts['sets']} sets; "
        f"foretold {facts['foretold_bytes'] / 1e9:.3f} GB"
    )


if __name__ == "__main__":
    main()
