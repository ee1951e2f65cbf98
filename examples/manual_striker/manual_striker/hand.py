"""Kind of instrument for a person who strikes on request."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pydantic import BaseModel, ConfigDict, Field

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.kinds import Finding, Kind, Opened, Opening
from hardware_drivers.measurement import ShotKey


class HandParameters(BaseModel):
    """Request text for the person."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    words: str = Field(default="strike {position} now", pattern=r"^[^{}]*\{position\}[^{}]*$")
    """What is said, with the position's name at ``{position}``."""
    who: str = Field(default="a person", min_length=1)
    """Who strikes: stored with every set."""


class HandStriker:
    """Striker that requests and returns: the digitizer waits for the strike."""

    def __init__(self, words: str, positions: tuple[str, ...], ask: Callable[[str], None]) -> None:
        self._words, self._positions, self._ask = words, positions, ask

    def strike(self, key: ShotKey) -> None:
        """Request one strike."""
        if key.position not in self._positions:
            raise ConfigurationError(
                f"nobody strikes at {key.position!r}; name the striker in [rig.positions.{key.position}]"
            )
        self._ask(self._words.format(position=key.position))

    def make_safe(self) -> None:
        """Withdraw the request; there is no coil."""
        self._ask("")


@contextmanager
def _open(parameters: HandParameters, opening: Opening) -> Iterator[Opened]:
    striker = HandStriker(parameters.words, opening.serves.get("striker", ()), opening.ask)
    try:
        yield Opened(striker=striker, identity={"struck_by": parameters.who})
    finally:
        striker.make_safe()


def _check(parameters: HandParameters, opening: Opening) -> Iterator[Finding]:
    yield Finding(
        subject=parameters.who,
        check="asked",
        state="warn",
        detail=f"strikes at {', '.join(opening.serves.get('striker', ()))} when asked, every "
        f"{opening.shot_interval_s:g} s",
        remedy="set schedule.shot_interval_s and rig.read_timeout_s to what a person can keep",
    )


KIND = Kind(parameters=HandParameters, open=_open, check=_check, reached_by=frozenset({"words"}))
