"""A rig of several instruments: which there are, and which of them serves each position."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from daq_service.settings.tables import Tables, remove_keys
from hardware_drivers.drive_parameters import NamedClimateProbe, NamedSupply
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.kinds import Role
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.plug_ins import find_kind

NEEDED: Mapping[str, tuple[Role, ...]] = {
    SOLITARY_WAVE: ("digitizer", "striker"),
    PULSE_ECHO: ("pulse_echo",),
}
"""Roles that a position of each method needs."""
ROLE_KEYS: Mapping[Role, str] = {"supply": "drive", "climate": "air"}
"""Tables of what serves no position."""


class InstrumentSettings(BaseModel):
    """One instrument of a mixed rig: `kind`, and the keys of that kind."""

    model_config = ConfigDict(extra="allow", frozen=True)

    kind: str = Field(min_length=1, max_length=100)
    """Kind: `daqmx`, `niscope`, or a name that an installed package offers."""

    @property
    def parameters(self) -> Tables:
        """Return the parameters of the instrument as JSON-ready values: all keys except ``kind``."""
        return self.model_dump(mode="json", exclude={"kind"})

    def measured(self) -> Tables:
        """Return the keys that affect the data as JSON-ready values: all except the instrument's address.

        If the kind is not installed, all keys are returned.
        """
        try:
            kind, _ = find_kind(self.kind)
        except ConfigurationError:
            return self.model_dump(mode="json")  # a reader has no need of its package
        return remove_keys(self.model_dump(mode="json"), kind.reached_by)


class PlaceSettings(BaseModel):
    """Instruments of one position, by their names in `[rig.instruments]`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    digitizer: str = ""
    """Samples the transducer."""
    striker: str = ""
    """Lifts and drops its striker."""
    pulse_echo: str = ""
    """Fires the ultrasonic probe."""

    @property
    def names(self) -> set[str]:
        """Return the names of the instruments that serve this position in any role."""
        return {name for _, name in self if name}


class MixedRig(BaseModel):
    """Tables of a rig of several instruments."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    instruments: dict[str, InstrumentSettings] = Field(default_factory=dict)
    """Instruments of a `mixed` rig by a name of your own; each is opened once."""
    positions: dict[str, PlaceSettings] = Field(default_factory=dict)
    """Which instruments serve each position of a `mixed` rig."""
    drive: NamedSupply | None = None
    """Electrochemical drive of a `mixed` rig by one of its instruments, instead of `[rig.supply]`."""
    air: NamedClimateProbe | None = None
    """Thermometer and hygrometer of a `mixed` rig among its instruments, instead of `[rig.climate]`."""

    @field_validator("instruments")
    @classmethod
    def _check_names(cls, instruments: dict[str, InstrumentSettings]) -> dict[str, InstrumentSettings]:
        """Return the instruments; ValueError for a name with other characters than A-Z, a-z, 0-9, - and _.

        A name has 1 to 40 characters.
        """
        for name in instruments:
            if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", name):
                raise ValueError(f"instrument name {name!r}: use up to 40 ASCII letters, digits, - and _")
        return instruments

    @model_validator(mode="after")
    def _check_named_instruments(self) -> Self:
        """Return the tables; ValueError if a position, the drive or the air names an undefined instrument."""
        named = {
            f"positions.{at}.{role}": name
            for at, place in self.positions.items()
            for role, name in place
            if name
        }
        named |= {f"{key}.instrument": its.instrument for key, its in self._list_rig_wide_tables().items()}
        for key, name in named.items():
            if name not in self.instruments:
                raise ValueError(
                    f"rig.{key} is {name!r}; there are: {', '.join(self.instruments) or 'none'}; add "
                    f"[rig.instruments.{name}], or correct the name"
                )
        return self

    def _list_rig_wide_tables(self) -> dict[str, NamedSupply | NamedClimateProbe]:
        """Return the given tables ``drive`` and ``air``, whose instruments serve no position, by key."""
        return {key: its for key, its in (("drive", self.drive), ("air", self.air)) if its is not None}

    def find_served_positions(self, name: str) -> dict[Role, tuple[str, ...]]:
        """Return role to positions of an instrument, in configuration order; empty if nothing uses it.

        Supply and climate serve no position: their tuple is empty.
        """
        served: dict[Role, tuple[str, ...]] = {}
        for roles in NEEDED.values():
            for role in roles:
                names = [at for at, place in self.positions.items() if getattr(place, role) == name]
                if names:
                    served[role] = tuple(names)
        if self.drive is not None and self.drive.instrument == name:
            served["supply"] = ()
        if self.air is not None and self.air.instrument == name:
            served["climate"] = ()
        return served

    def find_role_key(self, name: str, role: Role) -> str:
        """Return the dotted configuration key that first assigns this role to an instrument.

        Raises StopIteration if the instrument has the role at no position.
        """
        if role in ROLE_KEYS:
            return f"rig.{ROLE_KEYS[role]}.instrument"
        position = next(at for at, place in self.positions.items() if getattr(place, role) == name)
        return f"rig.positions.{position}.{role}"

    def require_role_instruments(self, methods: Mapping[str, str]) -> None:
        """Require that each position names exactly the instruments that its method needs, and is configured.

        Parameters
        ----------
        methods
            Positions of the experiment and how each is monitored.

        Raises
        ------
        ValueError
            An instrument is missing or not needed, or a position is unknown: key, value and remedy.
        """
        for position, method in methods.items():
            place = self.positions.get(position, PlaceSettings())
            for role, name in place:
                if role in NEEDED[method] and not name:
                    raise ValueError(
                        f"rig.positions.{position}.{role} is missing; a {method} position needs "
                        f"{' and '.join(NEEDED[method])}: name an instrument of [rig.instruments]"
                    )
                if name and role not in NEEDED[method]:
                    raise ValueError(
                        f"rig.positions.{position}.{role} is {name!r}, but {position} is a {method} "
                        f"position, which needs {' and '.join(NEEDED[method])}; take the key out"
                    )
        if unknown := [name for name in self.positions if name not in methods]:
            raise ValueError(
                f"rig.positions.{unknown[0]} is not in [positions], which has: {', '.join(methods)}; "
                "add it there, or take it out here"
            )
