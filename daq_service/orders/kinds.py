"""Orders to a running test: their kinds and arguments."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

LARGEST_ID = 2**53 - 1
_STRICT = ConfigDict(extra="forbid")

Author = Annotated[str, Field(min_length=1, max_length=80, description="Who gives the order")]


class NoArguments(BaseModel):
    """The order needs none."""

    model_config = _STRICT


class AlarmArguments(BaseModel):
    """Which alarm was seen."""

    model_config = _STRICT
    alarm_id: int = Field(ge=1, le=LARGEST_ID)
    note: str = Field(default="", max_length=2000)


class NoteArguments(BaseModel):
    """Why; shown to everybody."""

    model_config = _STRICT
    note: str = Field(default="", max_length=2000)


class TransducerArguments(BaseModel):
    """Which transducer, and why."""

    model_config = _STRICT
    position: str = Field(min_length=1, max_length=16)
    note: str = Field(default="", max_length=2000)


class SupplyArguments(BaseModel):
    """Voltage and current limit; null: as configured. Beyond the configured caps the recorder refuses."""

    model_config = _STRICT
    voltage_v: float | None = Field(default=None, gt=0.0, le=60.0)
    current_limit_a: float | None = Field(default=None, gt=0.0, le=100.0)
    note: str = Field(default="", max_length=2000)


class FinishNow(BaseModel):
    """Stop pacing: the rest of the simulated test runs as fast as it goes."""

    model_config = _STRICT
    kind: Literal["finish_now"]
    author: Author = "operator"
    arguments: NoArguments = NoArguments()


class Stop(BaseModel):
    """End the recording after the current set."""

    model_config = _STRICT
    kind: Literal["stop"]
    author: Author = "operator"
    arguments: NoArguments = NoArguments()


class AcknowledgeAlarm(BaseModel):
    """An operator has seen an alarm."""

    model_config = _STRICT
    kind: Literal["acknowledge_alarm"]
    author: Author = "operator"
    arguments: AlarmArguments


class Hold(BaseModel):
    """Strike nothing until the test is released, not even after a restart."""

    model_config = _STRICT
    kind: Literal["hold"]
    author: Author = "operator"
    arguments: NoteArguments = NoteArguments()


class Release(BaseModel):
    """End a hold: the next due set is taken."""

    model_config = _STRICT
    kind: Literal["release"]
    author: Author = "operator"
    arguments: NoteArguments = NoteArguments()


class Retire(BaseModel):
    """Strike a transducer no more; the others go on."""

    model_config = _STRICT
    kind: Literal["retire"]
    author: Author = "operator"
    arguments: TransducerArguments


class Reinstate(BaseModel):
    """Let a retired transducer strike again: what was wrong is put right."""

    model_config = _STRICT
    kind: Literal["reinstate"]
    author: Author = "operator"
    arguments: TransducerArguments


class SupplyOn(BaseModel):
    """Switch the corrosion drive on; only a person's order ever does."""

    model_config = _STRICT
    kind: Literal["supply_on"]
    author: Author
    arguments: SupplyArguments = SupplyArguments()


class SupplyOff(BaseModel):
    """Switch the corrosion drive off."""

    model_config = _STRICT
    kind: Literal["supply_off"]
    author: Author = "operator"
    arguments: NoteArguments = NoteArguments()


Command = Annotated[
    FinishNow | Stop | AcknowledgeAlarm | Hold | Release | Retire | Reinstate | SupplyOn | SupplyOff,
    Field(discriminator="kind"),
]
