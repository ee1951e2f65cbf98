"""Supply and climate probe with a text protocol, as kinds of instruments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager

from hardware_drivers.errors import InstrumentError
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, build_error_finding
from hardware_drivers.serial_port.parameters import (
    CLIMATE_REACHED_BY,
    SUPPLY_REACHED_BY,
    VISA_PREFIX,
    ClimateParameters,
    SupplyParameters,
)

CABLE = "check power, cable and the name in the configuration"


def _list_packages(parameters: SupplyParameters | ClimateParameters) -> tuple[str, ...]:
    """Return the distributions that the line needs: pyserial, with pyvisa and pyvisa-py for ``visa:``."""
    over_visa = parameters.line.port.startswith(VISA_PREFIX)
    return ("pyserial", "pyvisa", "pyvisa-py") if over_visa else ("pyserial",)


# The first call opens each port. The supply's process queries and stores its maker's data.


@contextmanager
def _open_supply(parameters: SupplyParameters, opening: Opening) -> Iterator[Opened]:
    """Yield the supply, not connected, and close it on exit; its first call opens the port."""
    from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

    with closing(ScpiPowerSupply(parameters, stamp=opening.stamp)) as supply:
        yield Opened(supply=supply)


@contextmanager
def _open_climate_probe(parameters: ClimateParameters, opening: Opening) -> Iterator[Opened]:
    """Yield the climate probe, not connected, and close it on exit; its first call opens the port."""
    from hardware_drivers.serial_port.climate_probe import ScpiClimateProbe

    with closing(ScpiClimateProbe(parameters, stamp=opening.stamp)) as probe:
        yield Opened(climate=probe)


def _build_identity_finding(subject: str, identity: Mapping[str, str]) -> Finding:
    """Build the finding, always ``ok``, on the identity that an instrument reports."""
    detail = ", ".join(identity.values())
    return Finding(subject=subject, check="identity", state="ok", detail=detail, values=dict(identity))


def check_supply(parameters: SupplyParameters, opening: Opening) -> Iterator[Finding]:
    """Query the supply and yield findings on identity, settings with protections, and output.

    A tripped protection fails; an unknown one, and an output that is on, are warnings. An instrument error
    becomes a failed finding, and is the last one. Nothing is set or switched but by ``setup_commands``.
    """
    from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

    subject, check = "supply", "identity"
    with closing(ScpiPowerSupply(parameters, stamp=opening.stamp)) as supply:
        try:
            yield _build_identity_finding(subject, supply.identity())
            check = "read-back"
            actual = supply.read_back(parameters.read_timeout_s)
            tripped, unknown = str(actual["tripped"]), str(actual["protection_unknown"])
            yield Finding(
                subject=subject,
                check=check,
                state="fail" if tripped else "warn" if unknown else "ok",
                detail=f"set to {actual['set_voltage_v']:g} V, limit {actual['set_current_limit_a']:g} A, "
                f"output {actual['output']}"
                + (f"; protection tripped: {tripped}" if tripped else "")
                + (f"; {unknown}" if unknown else ""),
                remedy="find the cause, then clear the protection at the instrument"
                if tripped
                else "look at the instrument's own display after it has gone off by itself",
                values=dict(actual),
            )
            check = "output"
            reading = supply.read(parameters.read_timeout_s)
            yield Finding(
                subject=subject,
                check=check,
                state="warn" if reading.output_on else "ok",
                detail=f"{'ON' if reading.output_on else 'off'}: {reading.voltage_v:.4g} V, "
                f"{reading.current_a:.4g} A",
                remedy="the drive is on although no recorder watches it: switch it off at the instrument, or "
                "start the recorder",
                values={name: getattr(reading, name) for name in ("output_on", "voltage_v", "current_a")},
            )
        except InstrumentError as error:
            yield build_error_finding(subject, check, error, CABLE)


def check_climate_probe(parameters: ClimateParameters, opening: Opening) -> Iterator[Finding]:
    """Query the climate probe and yield findings on its identity and one reading.

    An instrument error becomes a failed finding, and is the last one.
    """
    from hardware_drivers.serial_port.climate_probe import ScpiClimateProbe

    subject, check = "climate probe", "identity"
    with closing(ScpiClimateProbe(parameters, stamp=opening.stamp)) as probe:
        try:
            yield _build_identity_finding(subject, probe.identity())
            check = "reading"
            reading = probe.read(parameters.read_timeout_s)
            yield Finding(
                subject=subject,
                check=check,
                state="ok",
                detail=f"{reading.temperature_c:.2f} C, relative humidity {reading.relative_humidity:.0%}",
                values={name: getattr(reading, name) for name in ("temperature_c", "relative_humidity")},
            )
        except InstrumentError as error:
            yield build_error_finding(subject, check, error, CABLE)


SUPPLY = Kind(
    parameters=SupplyParameters,
    open=_open_supply,
    check=check_supply,
    packages=_list_packages,
    reached_by=SUPPLY_REACHED_BY,
)
CLIMATE = Kind(
    parameters=ClimateParameters,
    open=_open_climate_probe,
    check=check_climate_probe,
    packages=_list_packages,
    reached_by=CLIMATE_REACHED_BY,
)
