"""Ask for probes, supply and climate probe; each is connected and identified."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, TypeVar

from daq_service.cli.doctor.check import read_time_stamp
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.init import read_lab_config
from daq_service.settings.tables import KeyPath, Tables
from hardware_drivers.errors import InstrumentError
from hardware_drivers.niscope.parameters import NiscopeParameters, ProbeWiring
from hardware_drivers.serial_port.parameters import ClimateParameters, SerialLineParameters, SupplyParameters

if TYPE_CHECKING:
    from hardware_drivers.serial_port.climate_probe import ScpiClimateProbe
    from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

T = TypeVar("T")


def ask_for_other_instruments(
    dialogue: Dialogue, probes: Mapping[str, str] | None, supply: str, climate: str, *, asks: bool
) -> tuple[Tables, set[KeyPath]]:
    """Connect probes, supply and climate probe; return tables of [rig] and the tables to switch off.

    Instruments without an option are asked for if ``asks``.

    Parameters
    ----------
    probes
        ``RESOURCE[/CHANNEL]`` by position; None: the rig cannot have probes.
    supply, climate
        Serial ports; empty: not given.

    Raises
    ------
    InstrumentError
        An instrument named by an option does not respond.
    UsageError
        The answers at the terminal end.
    """
    tables: Tables = {}
    known = _identify_probes(probes or {})
    if asks and probes is not None:
        text = "NI-SCOPE board of an ultrasonic probe at A, as NI MAX names it"
        known |= _ask_for_address(dialogue, "probe", text, lambda address: _identify_probes({"A": address}))
    if known:
        usual = read_lab_config()[0]["rig"]["niscope"]
        tables["niscope"] = {
            **usual,
            "probes": {name: _to_parameter_table(wiring) for name, wiring in known.items()},
        }
    if asks and not (supply and climate):
        from hardware_drivers.serial_port.port import list_serial_ports

        for port, description in list_serial_ports().items():
            dialogue.report(f"found  {port} ({description})")
    for name, port, text, connect in (
        ("supply", supply, "Serial port of the supply that drives the corrosion", _identify_supply),
        ("climate", climate, "Serial port of a thermometer and hygrometer", _identify_climate_probe),
    ):
        table = connect(port) if port else {}
        if asks and not port:
            table = _ask_for_address(dialogue, name, text, connect)
        if table:
            tables[name] = table
            dialogue.report(f"{name}: {table['identity']}")
    off: set[KeyPath] = {("rig", name) for name in ("niscope", "supply", "climate") if name not in tables}
    return tables, off


def _ask_for_address(
    dialogue: Dialogue, name: str, text: str, connect: Callable[[str], dict[str, T]]
) -> dict[str, T]:
    """Ask for an address until an instrument responds there; return its table, empty for "-".

    Prints an instrument's error and asks again. Raises UsageError if the answers end.
    """

    def connect_to_address(address: str) -> dict[str, T]:
        """Connect to an address; raise ValueError with the instrument's error. "-" gives an empty table."""
        try:
            return {} if address == "-" else connect(address)
        except InstrumentError as error:
            raise ValueError(str(error)) from error

    return dialogue.ask(name, f"{text}, - for none", connect_to_address, default="-")


def _identify_probes(addresses: Mapping[str, str]) -> dict[str, ProbeWiring]:
    """Connect to each probe's board and return its wiring with the serial number, by position.

    Raises InstrumentError if a board does not respond.
    """
    found = {}
    for name, address in addresses.items():
        from hardware_drivers.niscope.pulse_echo import open_niscope

        resource, _, channel = address.partition("/")
        wiring = ProbeWiring(resource=resource, channel=channel or "0")
        with open_niscope(NiscopeParameters(probes={name: wiring})) as unit:
            found[name] = replace(wiring, serial_number=unit.serial_number(name))
    return found


def _identify_supply(port: str) -> Tables:
    """Read the identity of the supply at a port and return its table of [rig]; nothing is switched.

    Raises InstrumentError if it does not respond.
    """
    from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

    parameters = SupplyParameters(line=SerialLineParameters(port=port), identity=".+")
    with closing(ScpiPowerSupply(parameters, stamp=read_time_stamp)) as supply:
        return _identify(parameters, supply)


def _identify_climate_probe(port: str) -> Tables:
    """Read the identity of the climate probe at a port and return its table of [rig].

    Raises InstrumentError if it does not respond.
    """
    from hardware_drivers.serial_port.climate_probe import ScpiClimateProbe

    parameters = ClimateParameters(line=SerialLineParameters(port=port), identity=".+")
    with closing(ScpiClimateProbe(parameters, stamp=read_time_stamp)) as probe:
        return _identify(parameters, probe)


def _identify(
    parameters: SupplyParameters | ClimateParameters, instrument: ScpiPowerSupply | ScpiClimateProbe
) -> Tables:
    """Return the table of an instrument that matches its maker, model, serial number and any firmware.

    Raises InstrumentError if it does not respond.
    """
    identity = instrument.identity()
    parts = [identity[name] for name in ("maker", "model", "serial_number") if identity[name]]
    return _to_parameter_table(replace(parameters, identity=",".join(map(re.escape, parts))))


def _to_parameter_table(parameters: ProbeWiring | SupplyParameters | ClimateParameters) -> Tables:
    """Convert parameters to a configuration table, without those that are None."""
    return {name: value for name, value in asdict(parameters).items() if value is not None}
