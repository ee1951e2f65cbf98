"""Faults of the rig that the twin can simulate, one table each; none is active by default.

Each begins at ``onset_h``. Random faults then have a probability a shot or a rate; gradual ones reach their
full size ``ramp_h`` later (0: at once). All sizes are assumptions of whoever writes them: the paper
reports none of these faults. A through hole is no fault of the rig: see `ThinningParameters.hole_h`.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded, check_field_relation


@bounded
class _Fault:
    """Keys of every fault."""

    onset_h: Annotated[float, Ge(0.0), Le(1e6)] = 0.0
    """Hour at which it begins."""


@bounded
class _GradualFault(_Fault):
    """Keys of every gradual fault."""

    ramp_h: Annotated[float, Ge(0.0), Le(1e6)] = 0.0
    """Hours until it has its full size; 0: at once."""


@bounded
class MissedStrikeFault(_Fault):
    """The striker sticks: no wave, and nothing to trigger on."""

    probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Probability for each strike, repeated ones included."""


@bounded
class DoubleStrikeFault(_Fault):
    """The striker bounces: a second, weaker impact while the first one's waves are under way."""

    probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Probability a strike."""
    shortest_delay_s: Annotated[float, Gt(0.0), Le(1.0)] = 60e-6
    """Shortest time between the two impacts; drawn evenly up to the longest (assumption)."""
    longest_delay_s: Annotated[float, Gt(0.0), Le(1.0)] = 700e-6
    """Longest time between the two impacts (assumption)."""
    lowest_height_fraction: Annotated[float, Ge(0.01), Le(1.0)] = 0.3
    """Least drop height of the second impact over the first one's; drawn evenly up to 1 (assumption)."""

    def __post_init__(self) -> None:
        """Raise ValueError if the longest delay is below the shortest."""
        check_field_relation(self, "longest_delay_s", "at least", "shortest_delay_s", " s")


@bounded
class TiltFault(_GradualFault):
    """The sensor disk leans further than its play lets it; it acts as the sensor's own tilt does."""

    tilt_rad: Annotated[float, Ge(0.0), Le(0.2)] = 0.0
    """Full size of the tilt on top of the scattered one; together at most 0.2 rad."""


@bounded
class BeadWearFault(_GradualFault):
    """All contacts of the chain flatten: a larger radius of curvature, the spheres' mass unchanged."""

    radius_growth_fraction: Annotated[float, Ge(0.0), Le(3.0)] = 0.0
    """Full growth of the radius of curvature over the nominal radius; the stiffness A goes with its root."""


@bounded
class PztAgeingFault(_Fault):
    """The PZT disk loses sensitivity by the same fraction every year."""

    loss_fraction_per_year: Annotated[float, Ge(0.0), Le(0.99)] = 0.0
    """Part of the sensitivity lost in a year of 8,766 h."""


@bounded
class LooseContactFault(_Fault):
    """Chain and cable sit loosely: from shot to shot, gain and plate contact jump and jump back."""

    probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Probability a shot from then on."""
    gain_factor: Annotated[float, Gt(0.0), Le(1.0)] = 0.6
    """Gain of such a shot over the usual one (assumption)."""
    damping_factor: Annotated[float, Ge(1.0), Le(30.0)] = 4.0
    """Dashpot between chain and plate over the usual one (assumption)."""


@bounded
class TemperatureFault(_GradualFault):
    """A transducer warmer or colder than the room; it acts through the ways of `DriftParameters`."""

    change_k: Annotated[float, Ge(-100.0), Le(100.0)] = 0.0
    """Full difference from the room's temperature."""


@bounded
class ClippingFault:
    """The preamplifier is set too high: the incident wave leaves the digitizer's range."""

    onset_h: Annotated[float, Ge(0.0), Le(1e6)] = 0.0
    """Hour of the step."""
    gain_factor: Annotated[float, Ge(1.0), Le(1e3)] = 1.0
    """Gain after the step over the one before; the default range clips from about 2 on."""


@bounded
class SpikesFault(_Fault):
    """Short electrical pulses of either sign at random times; the board may trigger on one."""

    rate_hz: Annotated[float, Ge(0.0), Le(1e4)] = 0.0
    """Mean number a second; a record of the default length lasts 1.36 ms."""
    height_v: Annotated[float, Gt(0.0), Le(1e3)] = 1.0
    """Height of each at the digitizer's input (assumption)."""
    fwhm_s: Annotated[float, Gt(0.0), Le(1e-3)] = 1e-6
    """Full width at half maximum; the shape is a Gaussian (assumption)."""
    armed_s: Annotated[float, Ge(0.0), Le(10.0)] = 0.1
    """Time for which the digitizer is armed before the wave, open to a false trigger (assumption)."""


@bounded
class MainsHumFault(_Fault):
    """A ground loop: a sinusoid of the mains' frequency whose phase no strike knows."""

    amplitude_v: Annotated[float, Ge(0.0), Le(1e3)] = 0.0
    """Amplitude at the digitizer's input; below the trigger level, or the board would trigger on it."""
    frequency_hz: Annotated[float, Ge(10.0), Le(1e3)] = 50.0
    """Frequency: 50 or 60 Hz, or a harmonic."""


@bounded
class FaultParameters:
    """Faults of one position's transducer and of its channel; by default it has none."""

    missed: MissedStrikeFault = field(default_factory=MissedStrikeFault)
    """Strikes that do not come."""
    double: DoubleStrikeFault = field(default_factory=DoubleStrikeFault)
    """Strikes that come twice."""
    tilt: TiltFault = field(default_factory=TiltFault)
    """Tilt of the sensor disk."""
    bead_wear: BeadWearFault = field(default_factory=BeadWearFault)
    """Flattened contacts."""
    pzt_ageing: PztAgeingFault = field(default_factory=PztAgeingFault)
    """Loss of sensitivity over years."""
    loose_contact: LooseContactFault = field(default_factory=LooseContactFault)
    """Jumps of gain and damping."""
    temperature: TemperatureFault = field(default_factory=TemperatureFault)
    """Local heating or cooling."""
    clipping: ClippingFault = field(default_factory=ClippingFault)
    """Step of the preamplifier's gain."""
    spikes: SpikesFault = field(default_factory=SpikesFault)
    """Electrical pulses."""
    mains_hum: MainsHumFault = field(default_factory=MainsHumFault)
    """Sinusoid of the mains."""
