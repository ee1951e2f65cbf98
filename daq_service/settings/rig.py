"""The table of the rig: which instruments, and how long they are waited for."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from daq_service.settings.mixed import MixedRig
from hardware_drivers.daqmx.parameters import DaqmxParameters
from hardware_drivers.drive_parameters import DriveParameters, LogParameters
from hardware_drivers.niscope.parameters import NiscopeParameters
from hardware_drivers.playback.parameters import PlaybackParameters
from hardware_drivers.serial_port.parameters import ClimateParameters, SupplyParameters


class RigSettings(MixedRig):
    """Which instruments."""

    kind: Literal["simulated", "daqmx", "playback", "mixed"] = "simulated"
    """`simulated`: the physics twin; `daqmx`: NI boards as in `[rig.daqmx]` (ultrasound: `[rig.niscope]`);
    `playback`: a recording as in `[rig.playback]`; `mixed`: instruments of any kind, as in
    `[rig.instruments]`, each where `[rig.positions]` says."""
    read_timeout_s: float = Field(default=5.0, gt=0.0, le=600.0)
    """Longest wait for a record."""
    stall_timeout_s: float = Field(default=120.0, ge=2.0, le=3600.0)
    """Longest stall on top of `read_timeout_s`: a driver's call that hangs, a board's self-calibration, a
    slow disk. After it the supervisor restarts the recorder."""
    on_doubles: bool = False
    """The boards are doubles with the twin behind them (`solimon demo --rig`), not a real rig; only then may
    a `daqmx` rig run on the simulated clock."""
    daqmx: DaqmxParameters | None = None
    """Digitizer boards and coils."""
    niscope: NiscopeParameters | None = None
    """Ultrasonic probes on NI-SCOPE boards (needs the extra `solimon[niscope]`)."""
    supply: SupplyParameters | None = None
    """Electrochemical drive; absent: none is logged or switched."""
    climate: ClimateParameters | None = None
    """Thermometer and hygrometer; absent: none."""
    playback: PlaybackParameters | None = None
    """Recording to play back."""

    @model_validator(mode="after")
    def _check_kind_tables(self) -> Self:
        """Return the table; raise ValueError unless its subtables and ``on_doubles`` fit the kind."""
        if self.kind == "daqmx" and self.daqmx is None:
            raise ValueError("kind is 'daqmx', which needs [rig.daqmx]; `solimon init rig` writes one")
        if self.kind == "playback" and self.playback is None:
            raise ValueError("kind is 'playback', which needs [rig.playback] with its source")
        self._check_unused_tables()
        if self.on_doubles and self.kind != "daqmx":
            raise ValueError(f"on_doubles is true; it belongs to kind = 'daqmx', not to {self.kind!r}")
        return self

    def _check_unused_tables(self) -> None:
        """Raise ValueError for tables that do not fit the kind.

        Tables of mixed rigs belong to ``mixed`` only, which needs instruments, has no board tables, and takes
        one source each for supply and climate.
        """
        if self.kind != "mixed":
            given = [table for table in MixedRig.model_fields if getattr(self, table)]
            if given:
                raise ValueError(
                    f"kind is {self.kind!r}, which has no [rig.{given[0]}]; set kind = 'mixed', or "
                    "take it out"
                )
            return
        for text, named in (("supply", "drive"), ("climate", "air")):
            if getattr(self, text) is not None and getattr(self, named) is not None:
                raise ValueError(f"[rig.{text}] and [rig.{named}] are both given; keep one of them")
        if not self.instruments:
            raise ValueError("kind is 'mixed', which needs [rig.instruments.NAME] with kind and parameters")
        for table in ("daqmx", "niscope", "playback"):
            if getattr(self, table) is not None:
                raise ValueError(
                    f"kind is 'mixed', which has no [rig.{table}]; make it [rig.instruments.NAME] with "
                    f"kind = {table!r}"
                )

    @property
    def driven(self) -> DriveParameters | None:
        """Return the table ``[rig.supply]`` or ``[rig.drive]`` of the supply; None if neither is given."""
        return self.supply or self.drive

    @property
    def logged(self) -> LogParameters | None:
        """Return the table ``[rig.climate]`` or ``[rig.air]`` of the climate probe.

        None if neither is given.
        """
        return self.climate or self.air

    def copy_without_supply(self) -> RigSettings:
        """Return a copy without supply, drive and the drive's instrument, which another process opens."""
        used = None if self.drive is None else self.drive.instrument
        others = {name: item for name, item in self.instruments.items() if name != used}
        return self.model_copy(update={"supply": None, "drive": None, "instruments": others})

    @property
    def dry_run(self) -> bool:
        """Return whether this is a rehearsal: no coil is energized, and records show noise.

        Of a mixed rig, whether any instrument has ``dry_run = true``.
        """
        if self.kind == "mixed":
            return any(item.parameters.get("dry_run") is True for item in self.instruments.values())
        return self.kind == "daqmx" and self.daqmx is not None and self.daqmx.dry_run

    @property
    def on_twin(self) -> bool:
        """Return whether the twin produces the records, directly or through doubles of the boards."""
        return self.kind == "simulated" or self.on_doubles

    @property
    def simulates_time(self) -> bool:
        """Return whether a simulated clock is allowed: the twin or a playback, no real rig."""
        return self.on_twin or self.kind == "playback"
