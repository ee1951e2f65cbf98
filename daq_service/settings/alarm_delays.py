"""Delays and dead-bands of alarms (ISA-18.2, EEMUA 191): which kinds may have them, and how long."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from pydantic import BaseModel, ConfigDict, Field

DAY_S = 86_400.0
EARLIER_ALARM_KINDS: Mapping[str, str] = MappingProxyType(
    tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["earlier_kinds"]
)
"""Current kinds of alarms by their names in earlier versions, for stored rows and configurations."""
LONGEST_DELAY_S: Mapping[str, float] = {
    **dict.fromkeys(("wall_change", "transducer_change", "thickness_low", "few_valid_shots"), DAY_S),
    **dict.fromkeys(("supply_not_responding", "supply_off_unexpectedly", "supply_current_limit"), 10.0),
}
"""By kind. What is absent follows its condition at once: something has been done already that hangs on the
alarm (a transducer disabled, an interlock tripped, files named), or nobody might tell later (the recorder has
stopped, the disk does not take the event, the clock itself is doubted)."""
DEAD_BAND_KINDS = ("wall_change", "transducer_change", "thickness_low")
"""Kinds that compare a measured quantity with a limit and have no dead-band of their own."""
CONTACTS = ("wall", "rig", "computer", "cell")
"""Responsibilities of the persons that the guidance for alarms names."""


class AlarmKindSettings(BaseModel):
    """How an alarm follows its condition; the defaults: at once."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    on_delay_s: float = Field(default=0.0, ge=0.0, le=DAY_S)
    """The condition must hold for so long on the test's clock before the alarm is raised, or comes back."""
    off_delay_s: float = Field(default=0.0, ge=0.0, le=DAY_S)
    """The condition must be gone for so long on the test's clock before the alarm returns to normal."""
    dead_band_fraction: float = Field(default=0.0, ge=0.0, le=0.9)
    """Part of the limit by which the measured quantity must be back before the alarm returns to normal; of a
    thickness the limit is the loss that raises the alarm."""

    def require_valid_delays(self, kind: str) -> None:
        """Require that alarms of this kind may have these delays and this deadband.

        Raises
        ------
        ValueError
            The kind has no delays, a delay exceeds `LONGEST_DELAY_S`, or the kind has no deadband.
        """
        if kind not in LONGEST_DELAY_S:
            raise ValueError(
                f"{kind!r} has neither delays nor a dead-band: it follows its condition at once, or is no "
                f"kind of alarm; these have: {', '.join(LONGEST_DELAY_S)}"
            )
        longest_s = LONGEST_DELAY_S[kind]
        for name in ("on_delay_s", "off_delay_s"):
            if getattr(self, name) > longest_s:
                raise ValueError(
                    f"{kind}.{name} is {getattr(self, name):g} s; of this kind it is at most {longest_s:g} s"
                )
        if self.dead_band_fraction and kind not in DEAD_BAND_KINDS:
            raise ValueError(
                f"{kind}.dead_band_fraction is {self.dead_band_fraction:g}; only these kinds have one: "
                f"{', '.join(DEAD_BAND_KINDS)}. Take it out"
            )
