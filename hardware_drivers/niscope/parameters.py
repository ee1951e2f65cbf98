"""Parameters of the pulse-echo unit: the input of each probe, and its recording.

A file embeds them as ``[rig.niscope]`` with one ``[rig.niscope.probes.NAME]`` a position.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded

REACHED_BY = frozenset({"call_timeout_s"})
"""Not what is measured: how long the boards are waited for."""


@bounded
class ProbeWiring:
    """Wiring of one ultrasonic probe: its board, input and pulser-receiver."""

    resource: str
    """Name of the board in NI MAX or `nilsdev`, for example `PXI1Slot4`."""
    serial_number: str = ""
    """Serial number the board must report; empty: any board at `resource`."""
    other_resources: tuple[str, ...] = ()
    """Names under which a replugged board may come back; needs `serial_number`. No other board is touched."""
    channel: str = "0"
    """Input the receiver's RF output is wired to."""
    range_v: Annotated[float, Gt(0.0), Le(100.0)] = 1.0
    """Input range -range_v .. +range_v; one that the board has, a coerced one is refused."""
    offset_v: Annotated[float, Ge(-100.0), Le(100.0)] = 0.0
    """Centre of the input range."""
    coupling: Literal["ac", "dc"] = "dc"
    """Coupling of the input."""
    input_impedance_ohm: Literal[50, 1_000_000] = 50
    """Impedance of the input; 50 for a pulser-receiver's output."""
    bandwidth_hz: Annotated[float, Ge(0.0), Le(1e10)] = 0.0
    """Corner of the board's noise filter; 0: the board's full bandwidth."""
    trigger_source: Literal["external", "pfi_0", "pfi_1", "channel"] = "external"
    """Where the pulser's sync comes in: the analog TRIG input, a digital PFI line, or `channel` itself."""
    trigger_level_v: Annotated[float, Ge(-100.0), Le(100.0)] = 1.0
    """Level of an analog trigger (`external`, `channel`); a digital line has its own threshold."""
    trigger_slope: Literal["rising", "falling"] = "rising"
    """Edge of the sync."""
    firing_delay_s: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Time from the sync's edge to the firing pulse: the record starts this long after the trigger."""
    gain_db: Annotated[float, Ge(-60.0), Le(120.0)] = 30.0
    """Gain of the pulser-receiver as set by hand on its front; stored with every record."""

    def __post_init__(self) -> None:
        """Raise ValueError for a blank resource or channel, or other resources without a serial number."""
        for name in ("resource", "channel"):
            if not getattr(self, name).strip():
                raise ValueError(
                    f"{name} is empty; name the board and its input, for example PXI1Slot4 and 0"
                )
        if self.other_resources and not self.serial_number:
            raise ValueError(
                f"other_resources is {list(self.other_resources)} but serial_number is empty; give it, or "
                "another board could be taken for this one"
            )


@bounded
class NiscopeParameters:
    """Parameters of all ultrasonic probes and their records."""

    probes: Mapping[str, ProbeWiring]
    """Wiring of each pulse-echo position by its name."""
    sample_rate_hz: Annotated[float, Gt(0.0), Le(1e10)] = 100e6
    """Sampling rate (paper: 100 MHz); a coerced one is refused."""
    record_samples: Annotated[int, Ge(16), Le(10_000_000)] = 2_048
    """Samples from the firing pulse on: 20.5 us hold five back-wall echoes of the paper's plate."""
    averages: Annotated[int, Ge(1), Le(32_768)] = 16
    """Records of one acquisition, summed in whole counts: noise falls with the square root."""
    call_timeout_s: Annotated[float, Gt(0.0), Le(600.0)] = 5.0
    """Longest wait for the pulser's triggers."""

    def __post_init__(self) -> None:
        """Copy the probes; raise ValueError without a probe, or if probes cannot share their board."""
        if not self.probes:
            raise ValueError("probes is empty; give each pulse-echo position its [rig.niscope.probes.NAME]")
        object.__setattr__(self, "probes", dict(self.probes))
        self._check_shared_boards()

    def _check_shared_boards(self) -> None:
        """Raise ValueError if probes of one board share a channel, or differ in the board's other keys."""
        first_on: dict[str, str] = {}
        wired: dict[tuple[str, str], str] = {}
        for position, wiring in self.probes.items():
            other = first_on.setdefault(wiring.resource, position)
            first = self.probes[other]
            if (first.serial_number, first.other_resources) != (wiring.serial_number, wiring.other_resources):
                raise ValueError(
                    f"probes {other!r} and {position!r} are both on {wiring.resource!r}; give both the same "
                    "serial_number and other_resources"
                )
            other = wired.setdefault((wiring.resource, wiring.channel), position)
            if other != position:
                raise ValueError(
                    f"probes {other!r} and {position!r} are both on channel {wiring.channel} of "
                    f"{wiring.resource!r}; each needs its own input"
                )
