"""Ultrasonic probes, the electrochemical drive and the climate probe: identity and one reading each.

Nothing is switched. A pulser-receiver fires by itself; taking a record of it only listens.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np

from daq_service.cli.doctor.check import Check, failure
from daq_service.clock import boot_id
from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Echo
from hardware_drivers.measurement import ShotKey, Stamp
from hardware_drivers.niscope.parameters import NiscopeParameters
from hardware_drivers.serial_port.parameters import ClimateParameters, SupplyParameters

CABLE = "check power, cable and the name in the configuration"
RUNTIME = "see docs/how-to/install-the-ni-driver.md; then power, seating and resource in [rig.niscope.probes]"
SAFE_PART = 0.9
"""An echo beyond this part of the range is about to be clipped when the coupling gets better."""


def probe_checks(parameters: NiscopeParameters) -> Iterator[Check]:
    """Open each probe's board, ask who it is, and take one averaged record."""
    from hardware_drivers.niscope.pulse_echo import open_niscope

    for position, wiring in parameters.probes.items():
        name = f"probe {position}: board"
        try:
            # One at a time: a board that is missing must not hide the others.
            with open_niscope(replace(parameters, probes={position: wiring})) as unit:
                identity = unit.identity()
                yield Check(
                    area="rig",
                    name=name,
                    found=f"{identity[f'probe_{position}']}; NI-SCOPE {identity['ni_scope']}, package "
                    f"{identity['niscope']}",
                    values=dict(identity),
                )
                name = f"probe {position}: record"
                key = ShotKey(position=position, set_index=0, shot_index=0)
                yield from _record(position, unit.acquire(key, parameters.call_timeout_s))
        except InstrumentError as error:
            yield failure(name, error, RUNTIME)


def _record(position: str, echo: Echo) -> Iterator[Check]:
    waveform, settings = echo.waveform, echo.settings
    peak_v = float(np.abs(waveform.volts() - echo.offset_v).max())
    part = peak_v / waveform.calibration.range_v
    clipped = waveform.clipped or settings.get("clipped_records", 0.0) != 0.0
    yield Check(
        area="rig",
        name=f"probe {position}: record",
        state="warn" if clipped or part > SAFE_PART else "ok",
        found=f"{waveform.counts.size} samples at {waveform.sample_rate_hz / 1e6:g} MS/s, mean of "
        f"{echo.averages}, up to {peak_v:.3g} V ({part:.0%} of the range){', clipped' if clipped else ''}",
        remedy="lower the gain of the pulser-receiver, or take a larger range_v",
        values={"peak_v": peak_v, "sample_rate_hz": waveform.sample_rate_hz, "clipped": clipped},
    )
    yield Check(
        area="rig",
        name=f"probe {position}: self-calibration",
        found=f"on {settings['calibration_date']} at {settings['calibration_temperature_c']} C",
        values={key: settings[key] for key in ("calibration_date", "calibration_temperature_c")},
    )


def supply_checks(parameters: SupplyParameters) -> Iterator[Check]:
    """Ask the supply who it is, what is set, and what it gives."""
    from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

    name = "supply: identity"
    with closing(ScpiPowerSupply(parameters, stamp=stamp_now)) as supply:
        try:
            identity = supply.identity()
            yield Check(area="rig", name=name, found=", ".join(identity.values()), values=dict(identity))
            name = "supply: read-back"
            told = supply.read_back(parameters.read_timeout_s)
            tripped, unknown = str(told["tripped"]), str(told["protection_unknown"])
            yield Check(
                area="rig",
                name=name,
                state="fail" if tripped else "warn" if unknown else "ok",
                found=f"set to {told['set_voltage_v']:g} V, limit {told['set_current_limit_a']:g} A, output "
                f"{told['output']}"
                + (f"; protection tripped: {tripped}" if tripped else "")
                + (f"; {unknown}" if unknown else ""),
                remedy="find the cause, then clear the protection at the instrument"
                if tripped
                else "look at the instrument's own display after it has gone off by itself",
                values=dict(told),
            )
            name = "supply: output"
            reading = supply.read(parameters.read_timeout_s)
            yield Check(
                area="rig",
                name=name,
                state="warn" if reading.output_on else "ok",
                found=f"{'ON' if reading.output_on else 'off'}: {reading.voltage_v:.4g} V, "
                f"{reading.current_a:.4g} A",
                remedy="the drive is on although no recorder watches it: switch it off at the instrument, or "
                "start the recorder",
                values={
                    "output_on": reading.output_on,
                    "voltage_v": reading.voltage_v,
                    "current_a": reading.current_a,
                },
            )
        except InstrumentError as error:
            yield failure(name, error, CABLE)


def climate_checks(parameters: ClimateParameters) -> Iterator[Check]:
    """Ask the climate probe who it is, and for one reading."""
    from hardware_drivers.serial_port.climate_probe import ScpiClimateProbe

    name = "climate probe: identity"
    with closing(ScpiClimateProbe(parameters, stamp=stamp_now)) as probe:
        try:
            identity = probe.identity()
            yield Check(area="rig", name=name, found=", ".join(identity.values()), values=dict(identity))
            name = "climate probe: reading"
            reading = probe.read(parameters.read_timeout_s)
            yield Check(
                area="rig",
                name=name,
                found=f"{reading.temperature_c:.2f} C, relative humidity {reading.relative_humidity:.0%}",
                values={
                    "temperature_c": reading.temperature_c,
                    "relative_humidity": reading.relative_humidity,
                },
            )
        except InstrumentError as error:
            yield failure(name, error, CABLE)


def stamp_now() -> Stamp:
    """Time on this computer's own clocks."""
    return Stamp(utc_ns=time.time_ns(), mono_ns=time.monotonic_ns(), boot_id=boot_id())
