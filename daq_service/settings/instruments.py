"""The instruments that a configuration names: their kinds, their parameters, what each serves.

Every kind of rig comes to the same list, and whoever opens or checks instruments goes by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from daq_service.errors import UsageError
from daq_service.settings.mixed import InstrumentSettings, MixedRig
from daq_service.settings.tree import Settings
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.kinds import Kind, Role
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.plug_ins import Offer, find_kind, find_offers

TEXT: Mapping[Role, str] = {"supply": "text-supply", "climate": "text-climate"}
"""Kinds of `[rig.supply]` and `[rig.climate]`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument:
    """One instrument of a rig, not opened.

    Attributes
    ----------
    table
        Where its parameters stand in the configuration.
    serves
        Positions of each role that it has; none of supply and climate.
    parameters
        As its kind validated them.
    """

    name: str
    table: str
    kind: Kind[Any]
    offer: Offer
    parameters: object
    serves: Mapping[Role, tuple[str, ...]]


class ParametersError(ValueError):
    """Parameters that a kind refuses.

    Attributes
    ----------
    problems
        As `pydantic.ValidationError.errors` gives them, each with its place in the whole configuration.
    keys
        What the kind knows.
    """

    def __init__(self, table: str, error: ValidationError, keys: list[str]) -> None:
        super().__init__(f"[{table}] is refused: {error}")
        where = tuple(table.split("."))
        self.problems = [{**problem, "loc": (*where, *problem["loc"])} for problem in error.errors()]
        self.keys = keys


def validate_instruments(settings: Settings) -> list[Instrument]:
    """Return the configured instruments with their kinds and validated parameters; nothing is opened.

    In a rig that is not mixed, the first instrument is the rig's kind; supply and climate come last.

    Raises
    ------
    ConfigurationError
        A kind is missing or cannot be imported; an instrument lacks a role, or no position uses it.
    ParametersError
        A kind rejects its parameters.
    """
    rig = settings.rig
    instruments = []
    if rig.kind == "mixed":
        _require_offered_roles(rig)
        for name, item in rig.instruments.items():
            table = f"rig.instruments.{name}"
            instruments.append(
                _validate(name, table, item.kind, item.parameters, rig.find_served_positions(name))
            )
            if not instruments[-1].serves:
                raise ConfigurationError(
                    f"{table}: no position uses it; name {name!r} in [rig.positions], or take the table out"
                )
    else:
        transducers, probes = (
            tuple(settings.list_positions(method)) for method in (SOLITARY_WAVE, PULSE_ECHO)
        )
        wanted: dict[Role, tuple[str, ...]] = {"digitizer": transducers, "striker": transducers}
        of_probes: dict[Role, tuple[str, ...]] = {"pulse_echo": probes} if probes else {}
        if rig.kind == "daqmx":
            if rig.niscope is not None:
                instruments.append(_validate("niscope", "rig.niscope", "niscope", rig.niscope, of_probes))
        else:
            wanted |= of_probes
        table = f"rig.{rig.kind}"
        instruments.insert(0, _validate(rig.kind, table, rig.kind, getattr(rig, rig.kind, None), wanted))
    for role, kind in TEXT.items():
        parameters = getattr(rig, role)
        if parameters is not None:
            instruments.append(_validate(role, f"rig.{role}", kind, parameters, {role: ()}))
    return instruments


def list_instruments(settings: Settings) -> list[Instrument]:
    """Return the instruments as `validate_instruments` does, with its errors as UsageError.

    Raises
    ------
    UsageError
        An instrument is not available as configured: the cause and the remedy.
    """
    try:
        return validate_instruments(settings)
    except (ConfigurationError, ParametersError) as error:
        raise UsageError(str(error)) from error


def fill_instrument_defaults(settings: Settings) -> Settings:
    """Return the settings with all default parameters of a mixed rig's instruments.

    Settings of other rigs are returned unchanged. Raises the errors of `validate_instruments`.
    """
    if settings.rig.kind != "mixed":
        return settings
    filled = {
        item.name: InstrumentSettings(kind=item.offer.name, **dump_parameters(item))
        for item in validate_instruments(settings)
        if item.name in settings.rig.instruments
    }
    return settings.model_copy(update={"rig": settings.rig.model_copy(update={"instruments": filled})})


def dump_parameters(instrument: Instrument) -> dict[str, object]:
    """Convert all parameters of an instrument, defaults included, to JSON-ready values by key."""
    adapter: TypeAdapter[object] = TypeAdapter(instrument.kind.parameters)
    values: dict[str, object] = adapter.dump_python(instrument.parameters, mode="json")
    return values


def _validate(
    name: str, table: str, kind_name: str, values: object, serves: Mapping[Role, tuple[str, ...]]
) -> Instrument:
    """Find the kind of an instrument, validate its parameters (None counts as empty), and return both.

    Raises ConfigurationError (unknown kind, or it rejects the served positions) or ParametersError.
    """
    try:
        kind, offer = find_kind(kind_name)
    except ConfigurationError as error:
        raise ConfigurationError(f"{table}: {error}") from error
    adapter: TypeAdapter[object] = TypeAdapter(kind.parameters)
    try:
        parameters = adapter.validate_python({} if values is None else values)
    except ValidationError as error:
        known = adapter.json_schema().get("properties", {})
        raise ParametersError(table, error, sorted(known)) from error
    try:
        if serves:
            kind.require(parameters, serves)
    except ValueError as error:
        raise ConfigurationError(f"{table}: {error}") from error
    return Instrument(name=name, table=table, kind=kind, offer=offer, parameters=parameters, serves=serves)


def _require_offered_roles(rig: MixedRig) -> None:
    """Raise ConfigurationError if an instrument's kind lacks a role, or the supply also has another role.

    Kinds that no installed package offers are skipped here.
    """
    known = find_offers()
    for name, item in rig.instruments.items():
        offer = known.get(item.kind)  # one that is unknown is told with its parameters
        serves = rig.find_served_positions(name)
        for role in serves:
            if offer is not None and role not in offer.roles:
                raise ConfigurationError(
                    f"{rig.find_role_key(name, role)} is {name!r}, whose kind {item.kind!r} is a "
                    f"{' and '.join(offer.roles)}, not a {role}; name another instrument"
                )
        if "supply" in serves and len(serves) > 1:
            raise ConfigurationError(
                f"rig.drive.instrument is {name!r}, which is a {' and '.join(serves)}, too; the drive has a "
                "process of its own, so its instrument can be nothing else: name one of its own"
            )
