"""Choice of the instrument under test and its configuration, from the options of the command."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from hardware_drivers.conformance.bench import Double
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.kinds import Kind, Role
from hardware_drivers.plug_ins import Offer, find_kind

AT = "B"
"""Position where no configuration names one."""
OF_POSITIONS: tuple[Role, ...] = ("digitizer", "striker", "pulse_echo")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChosenInstrument:
    """Instrument under test, not opened.

    Attributes
    ----------
    table
        Its parameters as the configuration gives them.
    serves
        Positions of each role that it has; none of supply and climate.
    strikers
        Kind and table of whatever strikes at each position, this instrument or another.
    configuration
        The whole file.
    """

    kind: Kind[object]
    offer: Offer
    table: Mapping[str, object]
    serves: Mapping[Role, tuple[str, ...]]
    strikers: Mapping[str, tuple[Kind[object], Mapping[str, object]]] = field(default_factory=dict)
    configuration: Mapping[str, object] = field(default_factory=dict)


def choose_instrument(kind_name: str, file: Path | None) -> ChosenInstrument:
    """Find a kind by its name, and its only instrument in ``[rig.instruments]`` of a configuration.

    Without a file its parameters are the defaults, and it serves position `AT` in every role that it has.

    Raises
    ------
    ConfigurationError
        No such kind; the file cannot be read; it has no instrument of the kind, or several; no position
        names the instrument; or the kind of a position's striker cannot be found.
    """
    kind, offer = find_kind(kind_name)
    if file is None:
        roles = {role: (AT,) if role in OF_POSITIONS else () for role in offer.roles}
        strikers = {AT: (kind, dict[str, object]())} if "striker" in offer.roles else {}
        return ChosenInstrument(kind=kind, offer=offer, table={}, serves=roles, strikers=strikers)
    configuration = _read_toml(file)
    rig = configuration.get("rig", {})
    instruments: Mapping[str, Mapping[str, Any]] = rig.get("instruments", {})
    named = [name for name, table in instruments.items() if table.get("kind") == kind_name]
    if len(named) != 1:
        raise ConfigurationError(
            f"{file} has {len(named)} instruments of the kind {kind_name!r} in [rig.instruments]; leave "
            "exactly one there"
        )
    (name,) = named
    positions: Mapping[str, Mapping[str, str]] = rig.get("positions", {})
    serves: dict[Role, tuple[str, ...]] = {}
    for role in offer.roles:
        at = tuple(place for place, by_role in positions.items() if by_role.get(role) == name)
        if at or role not in OF_POSITIONS:
            serves[role] = at
    if not serves:
        raise ConfigurationError(
            f"no position of {file} names {name!r}; add [rig.positions.{AT}] with "
            f"{' and '.join(f'{role} = {name!r}' for role in offer.roles)}"
        )
    return ChosenInstrument(
        kind=kind,
        offer=offer,
        table=_read_parameters(instruments[name]),
        serves=serves,
        strikers={
            place: (find_kind(table["kind"])[0], _read_parameters(table))
            for place in serves.get("digitizer", ())
            if (table := instruments.get(positions[place].get("striker", ""))) is not None
        },
        configuration=configuration,
    )


def import_double(where: str) -> Double:
    """Import the `Double` that ``MODULE:NAME`` names and return it.

    Raises
    ------
    ConfigurationError
        The module cannot be imported or lacks the name, or the object is no `Double`.
    """
    module, _, name = where.partition(":")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigurationError(f"no double {where!r} ({error}); give MODULE:NAME") from error
    if not isinstance(found, Double):
        raise ConfigurationError(
            f"{where} is a {type(found).__name__}; give a hardware_drivers.conformance.bench.Double"
        )
    return found


def _read_parameters(table: Mapping[str, object]) -> dict[str, object]:
    """Return the parameters of an instrument's table: a copy without the key ``kind``."""
    return {key: value for key, value in table.items() if key != "kind"}


def _read_toml(file: Path) -> Mapping[str, Any]:
    """Read and parse a TOML file; ConfigurationError if it cannot be read, is no UTF-8 or no TOML."""
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigurationError(f"{file} cannot be read ({error.strerror}); give a TOML file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{file} is no TOML file ({error}); correct it") from error
