"""Kind of instrument for the oscilloscope.

Its parameters, its digitizer, and the checks of `solimon doctor`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from block_scope import api
from block_scope.unit import Unit
from hardware_drivers.errors import ConfigurationError, InstrumentError
from hardware_drivers.instruments import Acquired, require_timeout
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, Role, build_error_finding
from hardware_drivers.measurement import Calibration, ShotKey, Waveform

log = logging.getLogger(__name__)


class BlockScopeParameters(BaseModel):
    """Parameters of one oscilloscope."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    channels: dict[str, Literal["A", "B", "C", "D"]] = Field(min_length=1)
    """Input of each position's transducer."""
    serial: str = ""
    """Serial number; empty: the first oscilloscope found."""
    library: str = "blockscope"
    """Name or path of its maker's library."""
    resolution_bits: Literal[8, 12, 14, 16] = 14
    """Resolution of the ADC."""
    range_v: float = 5.0
    """Input range, half of which the incident wave should fill; one that the oscilloscope has."""
    sample_rate_hz: float = Field(default=10e6, gt=0.0, le=100e6)
    """Sampling rate; one that the oscilloscope would round is refused."""
    pretrigger_samples: int = Field(default=1_000, ge=2, le=1_000_000)
    """Samples before the trigger."""
    record_samples: int = Field(default=13_600, ge=16, le=10_000_000)
    """Samples of a record."""
    trigger_level_v: float = 0.25
    """Voltage at the input that triggers: a tenth of the incident wave."""
    trigger_slope: Literal["rising", "falling"] = "rising"
    """Direction in which the level is passed."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        ranges_v = [millivolts / 1e3 for millivolts in api.RANGES_MV]
        if self.range_v not in ranges_v:
            raise ValueError(f"range_v is {self.range_v}; the oscilloscope has {ranges_v}")
        if self.pretrigger_samples >= self.record_samples:
            raise ValueError(
                f"pretrigger_samples is {self.pretrigger_samples}; it must be less than record_samples "
                f"({self.record_samples})"
            )
        if abs(self.trigger_level_v) >= self.range_v:
            raise ValueError(
                f"trigger_level_v is {self.trigger_level_v} V; it must lie inside range_v ({self.range_v} V)"
            )
        return self


class BlockScopeDigitizer:
    """Digitizer that runs a block for each shot."""

    def __init__(self, unit: Unit, parameters: BlockScopeParameters) -> None:
        self._unit = unit
        self._parameters = parameters
        self._armed: ShotKey | None = None

    def arm(self, key: ShotKey) -> None:
        """Run a block at the position's input; a lost unit is opened again."""
        p, unit = self._parameters, self._unit
        if key.position not in p.channels:
            raise ConfigurationError(f"no input for {key.position!r}; channels has: {', '.join(p.channels)}")
        if self._armed is not None:
            raise ConfigurationError(f"already armed for {self._armed}; read or disarm first")
        if not unit.is_open:
            unit.open()
        unit.start(
            p.channels[key.position],
            range_v=p.range_v,
            level_v=p.trigger_level_v,
            rising=p.trigger_slope == "rising",
            samples=(p.pretrigger_samples, p.record_samples - p.pretrigger_samples),
            base=unit.timebase(p.sample_rate_hz),
        )
        self._armed = key

    def read(self, timeout_s: float) -> Acquired:
        """Wait for the block's end and return it; after any error nothing runs."""
        require_timeout(timeout_s)
        if self._armed is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        try:
            self._unit.wait(timeout_s)
            codes, overflow = self._unit.values(self._parameters.record_samples)
        finally:
            self.disarm()
        return Acquired(
            waveform=Waveform(
                counts=codes,
                sample_rate_hz=self._parameters.sample_rate_hz,
                pretrigger_samples=self._parameters.pretrigger_samples,
                calibration=self._calibration(),
            ),
            settings={
                "trigger_level_v": self._parameters.trigger_level_v,
                "left_its_range": "yes" if overflow else "no",
            },
        )

    def disarm(self) -> None:
        """Stop the block; harmless when there is none, and when the unit is lost."""
        armed, self._armed = self._armed, None
        if armed is not None and self._unit.is_open:
            try:
                self._unit.stop()
            except InstrumentError as error:
                log.warning("the block of %s could not be ended: %s", armed, error)

    def _calibration(self) -> Calibration:
        range_v = self._parameters.range_v
        return Calibration(
            coefficients_v=np.array([0.0, range_v / self._unit.highest_code]),
            resolution_bits=self._parameters.resolution_bits,
            range_v=range_v,
        )


@contextmanager
def _opened_unit(parameters: BlockScopeParameters) -> Iterator[Unit]:
    unit = Unit(api.load(parameters.library), parameters.serial, parameters.resolution_bits)
    try:
        unit.open()
        yield unit
    finally:
        unit.close()


@contextmanager
def _open(parameters: BlockScopeParameters, opening: Opening) -> Iterator[Opened]:
    with _opened_unit(parameters) as unit:
        unit.timebase(parameters.sample_rate_hz)
        digitizer = BlockScopeDigitizer(unit, parameters)
        identity = {
            "model": unit.info(api.MODEL),
            "serial": unit.info(api.SERIAL),
            "library_version": unit.info(api.LIBRARY_VERSION),
            "calibrated": unit.info(api.CALIBRATION_DATE),
        }
        try:
            yield Opened(digitizer=digitizer, identity=identity)
        finally:
            digitizer.disarm()


def _check(parameters: BlockScopeParameters, opening: Opening) -> Iterator[Finding]:
    """Check the identity of the oscilloscope."""
    subject = f"oscilloscope {parameters.serial}".strip()
    try:
        with _opened_unit(parameters) as unit:
            detail = f"{unit.info(api.MODEL)}, serial number {unit.info(api.SERIAL)}"
            yield Finding(subject=subject, check="answers", state="ok", detail=detail)
            unit.timebase(parameters.sample_rate_hz)
    except InstrumentError as error:
        yield build_error_finding(subject, "answers", error, "check its cable and its power")


def _require(parameters: BlockScopeParameters, serves: Mapping[Role, tuple[str, ...]]) -> None:
    for position in serves.get("digitizer", ()):
        if position not in parameters.channels:
            raise ValueError(f"channels has no {position!r}; add its input, or name another digitizer for it")


KIND = Kind(
    parameters=BlockScopeParameters,
    open=_open,
    check=_check,
    reached_by=frozenset({"library"}),
    require=_require,
)
