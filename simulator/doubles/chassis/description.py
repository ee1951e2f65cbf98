"""Description of a double: boards, wiring, the specimen behind them. Frozen, bounded, JSON in and out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Gt, Le
from pydantic import TypeAdapter

from hardware_drivers.bounds import bounded
from simulator.doubles.chassis.boards import BOARD_TYPES, BoardType
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.chassis.scopes import ScopeParameters
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import AdcParameters
from simulator.parameters.experiment import TwinParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters


@bounded
class BoardParameters:
    """Board in the chassis."""

    serial_number: Annotated[int, Ge(0), Le(0xFFFFFFFF)]
    """What a driver finds the board by; NI's simulated devices have 0."""
    product: str
    """One of `boards.BOARD_TYPES`."""
    name: str
    """Name given by NI MAX; another one after a replug."""
    over_range_fraction: Annotated[float, Ge(0.0), Le(0.1)] = 0.02
    """The codes reach this far beyond the range."""
    offset_v: Annotated[float, Ge(-1.0), Le(1.0)] = 1.2e-3
    """Constant term of the scaling polynomial."""
    gain_error_fraction: Annotated[float, Ge(-0.1), Le(0.1)] = 8e-4
    """Departure of its linear term from the ideal one."""
    quadratic_fraction: Annotated[float, Ge(-0.01), Le(0.01)] = 3e-5
    """Its quadratic term at the last code, as a fraction of the range."""
    cubic_fraction: Annotated[float, Ge(-0.01), Le(0.01)] = -2e-5
    """Its cubic term at the last code, as a fraction of the range."""
    self_calibration_shift_v: Annotated[float, Ge(-0.1), Le(0.1)] = 2e-4
    """Each self-calibration moves the constant term by this: a driver must read the polynomial again."""
    temperature_c: Annotated[float, Ge(-40.0), Le(120.0)] = 38.5
    """Of the board's own sensor."""
    calibrated: str = "2026-01-12T09:30"
    """Last self-calibration before the double started, ISO time to the minute."""
    simulated: bool = False
    """Behaves as a device that NI's own driver simulates: no calibration to tell of, every task done at once,
    full-scale sine waves whatever the trigger, no line that moves."""

    def __post_init__(self) -> None:
        if self.product not in BOARD_TYPES:
            raise ValueError(f"product is {self.product!r}; known are: {', '.join(BOARD_TYPES)}")
        if not self.name or not self.name.replace("_", "").isalnum():
            raise ValueError(f"name is {self.name!r}; it must be letters, digits and underscores")

    @property
    def kind(self) -> BoardType:
        """Return the board type of the product, with the figures of its data sheet."""
        return BOARD_TYPES[self.product]

    def adc(self, record: AdcParameters) -> AdcParameters:
        """Return the converter parameters of a record with this board's resolution, over-range and errors.

        Raises
        ------
        ValueError
            The twin has no such converter.
        """
        return replace(
            record,
            resolution_bits=self.kind.resolution_bits,
            over_range_fraction=self.over_range_fraction,
            offset_v=self.offset_v,
            gain_error_fraction=self.gain_error_fraction,
            quadratic_fraction=self.quadratic_fraction,
            cubic_fraction=self.cubic_fraction,
        )


@bounded
class TransducerWiring:
    """Wiring of one solitary-wave transducer, and the plate under it."""

    ai_serial: int
    """Board that samples the sensor."""
    ai_channel: Annotated[int, Ge(0), Le(127)] = 0
    """Its analog input."""
    counter_serial: int
    """Board that pulses the coil."""
    counter: Annotated[int, Ge(0), Le(7)] = 0
    """Its counter."""
    lift_s: Annotated[float, Gt(0.0), Le(1.0)] = 5e-3
    """A shorter pulse does not lift the striker (assumption: an electromagnet of a few millihenry)."""
    chain: ChainParameters = field(default_factory=ChainParameters)
    """The chain of spheres."""
    plate: PlateParameters = field(default_factory=PlateParameters)
    """The plate below."""
    corrosion: CorrosionParameters = field(default_factory=CorrosionParameters)
    """Footprint of the corrosion there."""
    crosstalk: Crosstalk = field(default_factory=Crosstalk)
    """What its coil and the mains couple into its sensor."""


@bounded
class ProbeWiring:
    """Wiring of one ultrasonic probe.

    Its pulser-receiver fires by itself and sends a sync each time.
    """

    resource: str
    """NI-SCOPE resource name; a name that no board of `scopes` has brings one of the default kind."""
    channel: str = "0"
    """Channel of the digitizer."""
    thickness_m: Annotated[float, Gt(0.0), Le(1.0)] = 6.35e-3
    """Pristine wall under the probe."""
    sync_terminal: str = "VAL_EXTERNAL"
    """Trigger input of the digitizer that the pulser's sync is wired to."""
    sync_v: Annotated[float, Gt(0.0), Le(100.0)] = 5.0
    """Height of the sync pulse."""
    sync_to_firing_s: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Time from the sync's edge to the firing pulse."""
    repetition_hz: Annotated[float, Gt(0.0), Le(1e6)] = 1000.0
    """Firings a second."""
    switched_on: bool = True
    """Off: the pulser never fires."""


@bounded
class Description:
    """Description of one double.

    Raises
    ------
    ValueError
        A transducer is wired to what is not there, or two to the same input or counter.
    """

    boards: tuple[BoardParameters, ...]
    """Boards in the system."""
    transducers: Mapping[str, TransducerWiring] = field(default_factory=dict)
    """By position."""
    probes: Mapping[str, ProbeWiring] = field(default_factory=dict)
    """By position."""
    scopes: tuple[ScopeParameters, ...] = ()
    """NI-SCOPE boards that differ from the default kind."""
    twin: TwinParameters = field(default_factory=TwinParameters)
    """Scenario of the experiment; of its ADC only what no board decides is used."""
    driver_version: tuple[int, int, int] = (24, 8, 0)
    """NI-DAQmx version that the double claims."""
    shots_per_set: Annotated[int, Ge(1), Le(1000)] = 10
    """How strikes are counted into sets while nobody announces them."""
    hour_h: Annotated[float, Ge(0.0), Le(1e6)] = 0.0
    """Hour of the experiment while nobody announces it."""

    @property
    def all_scopes(self) -> tuple[ScopeParameters, ...]:
        """Return all NI-SCOPE boards: `scopes`, then a default one for each other resource of a probe."""
        named = {scope.name for scope in self.scopes}
        missing = dict.fromkeys(
            probe.resource for probe in self.probes.values() if probe.resource not in named
        )
        first = ScopeParameters().serial_number
        default = (ScopeParameters(name=name, serial_number=first + i) for i, name in enumerate(missing))
        return (*self.scopes, *default)

    def __post_init__(self) -> None:
        by_serial = {board.serial_number: board for board in self.boards}
        if len(by_serial) < len(self.boards) or len({b.name.casefold() for b in self.boards}) < len(
            self.boards
        ):
            raise ValueError("two boards share a serial number or a name")
        used: set[tuple[int, str]] = set()
        for position, wiring in self.transducers.items():
            inputs = by_serial[wiring.ai_serial].kind if wiring.ai_serial in by_serial else None
            counters = by_serial[wiring.counter_serial].kind if wiring.counter_serial in by_serial else None
            if inputs is None or counters is None:
                raise ValueError(f"transducer {position} is wired to a board that is not described")
            if wiring.ai_channel >= inputs.analog_inputs:
                raise ValueError(
                    f"transducer {position} is wired to ai{wiring.ai_channel}; {inputs.product} has "
                    f"{inputs.analog_inputs} inputs"
                )
            if wiring.counter >= len(counters.counter_terminals):
                raise ValueError(
                    f"transducer {position} is wired to ctr{wiring.counter}; {counters.product} has "
                    f"{len(counters.counter_terminals)} counters"
                )
            ends = {
                (wiring.ai_serial, f"ai{wiring.ai_channel}"),
                (wiring.counter_serial, f"ctr{wiring.counter}"),
            }
            if ends & used:
                raise ValueError(f"transducer {position} shares an input or a counter with another one")
            used |= ends


_ADAPTER = TypeAdapter(Description)


def to_json(description: Description) -> str:
    """Serialize a description as JSON text, for `from_json`."""
    return _ADAPTER.dump_json(description, indent=1).decode()


def from_json(text: str) -> Description:
    """Parse a description from JSON text.

    Raises
    ------
    pydantic.ValidationError
        It is no JSON, a key is unknown or missing, or a value is out of bounds.
    """
    return _ADAPTER.validate_json(text)


def read_description(path: Path) -> Description:
    """Read a description from a JSON file in UTF-8.

    Raises
    ------
    OSError, pydantic.ValidationError
        The file cannot be read, or is no valid description (`from_json`).
    """
    return from_json(path.read_text(encoding="utf-8"))


SIMULTANEOUS_18_BIT = BoardParameters(serial_number=0x01E18096, product="PXIe-6396", name="PXI1Slot2")
SIMULTANEOUS_16_BIT = BoardParameters(serial_number=0x01E16086, product="PXIe-6386", name="PXI1Slot3")
SIMULTANEOUS_12_BIT = BoardParameters(serial_number=0x00F12015, product="PXI-6115", name="PXI1Slot4")
SLOW = BoardParameters(serial_number=0x00C16021, product="PCI-6221", name="Dev1")


def build_default_description(twin: TwinParameters | None = None) -> Description:
    """Build the description of a chassis with four boards of different kinds.

    The paper's transducers B, C and D each have another board; probe A has a digitizer. The twin is the
    default if ``twin`` is None.
    """
    boards = (SIMULTANEOUS_18_BIT, SIMULTANEOUS_16_BIT, SIMULTANEOUS_12_BIT, SLOW)
    wide, usual, narrow, _ = (board.serial_number for board in boards)
    small, large = CorrosionParameters(size_m=25.4e-3), CorrosionParameters(size_m=50.8e-3)
    return Description(
        boards=boards,
        transducers={
            "B": TransducerWiring(ai_serial=wide, counter_serial=wide, corrosion=small),
            "C": TransducerWiring(ai_serial=usual, counter_serial=usual, corrosion=large),
            "D": TransducerWiring(ai_serial=narrow, counter_serial=narrow, corrosion=small),
        },
        probes={"A": ProbeWiring(resource="PXI1Slot5")},
        twin=twin or TwinParameters(),
    )
