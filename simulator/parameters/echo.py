"""Parameters of the ultrasonic probe, its receiver, the scattering far wall, and the liquid behind it.

The defaults are the paper's experiment as far as it can be known; what each rests on stands beside it. A
smooth wall under the straight path of equation 17 has `element_separation_m`, `roughness_fraction`,
`velocity_per_k` and `bubble_probability` 0.
"""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le, Lt

from hardware_drivers.bounds import bounded


@bounded
class EchoParameters:
    """Dual-element ultrasonic probe and its receiver (paper: Olympus DHC713, 100 MHz sampling)."""

    sample_rate_hz: Annotated[float, Gt(0.0), Le(1e10)] = 100e6
    """Sampling rate (paper: 100 MHz)."""
    record_samples: Annotated[int, Ge(16), Le(10_000_000)] = 2_048
    """Samples from the firing pulse on: 20.5 us hold five back-wall echoes of the pristine plate."""
    centre_frequency_hz: Annotated[float, Gt(0.0), Le(1e9)] = 5e6
    """Centre frequency of the pulse (assumption: a common one for probes of this kind)."""
    bandwidth_fraction: Annotated[float, Gt(0.0), Le(1.5)] = 0.5
    """-6 dB bandwidth over the centre frequency (assumption)."""
    delay_s: Annotated[float, Ge(0.0), Le(1e-3)] = 8e-6
    """Time inside the probe's delay lines, D of equation 17 (assumption: the paper gives none)."""
    delay_per_k: Annotated[float, Ge(-0.01), Le(0.01)] = 0.0
    """Relative change of `delay_s` a kelvin above the room's mean temperature."""
    velocity_m_per_s: Annotated[float, Gt(0.0), Le(2e4)] = 5_900.0
    """Longitudinal wave speed (handbook value of steel)."""
    velocity_per_k: Annotated[float, Ge(-0.01), Le(0.01)] = -1.8e-4
    """Relative change of `velocity_m_per_s` a kelvin (thickness gauges take this for steel: 1 % in 55 K)."""
    element_separation_m: Annotated[float, Ge(0.0), Le(0.1)] = 2.7e-3
    """Distance s of the points where the sound enters and leaves the wall: its way is a V of length
    sqrt(4 th^2 + s^2). The centroids of the halves of a 6.35 mm tip are so far apart (assumption: the size
    of the tip); 0 is the straight path of equation 17."""
    beam_diameter_m: Annotated[float, Gt(0.0), Le(0.1)] = 3.2e-3
    """-6 dB diameter of the spot on the far wall that sender and receiver share (assumption)."""
    front_wall_v: Annotated[float, Ge(0.0), Le(100.0)] = 0.02
    """Peak of the front-wall echo: cross-talk, small in a dual-element probe (assumption)."""
    back_wall_v: Annotated[float, Gt(0.0), Le(100.0)] = 0.5
    """Peak of the first back-wall echo of a smooth wall without attenuation (assumption)."""
    multiple_ratio: Annotated[float, Ge(0.0), Lt(1.0)] = 0.45
    """Each further back-wall echo over the one before, attenuation apart (assumption)."""
    attenuation_db_per_m: Annotated[float, Ge(0.0), Le(1e4)] = 50.0
    """Attenuation along the path at the centre frequency (assumption: structural steel at 5 MHz)."""
    attenuation_exponent: Annotated[float, Ge(0.0), Le(6.0)] = 0.0
    """Power of the frequency it grows with: 0 not at all, 1 absorption, 4 scatter by small grains."""
    roughness_fraction: Annotated[float, Ge(0.0), Le(2.0)] = 0.2
    """SD of the logarithm of the wall lost at a spot: so a patch of 25.4 mm varies between 2 and 5 mm, as
    the paper's core did. 0 is a smooth far wall; a wall that has lost nothing is always smooth."""
    correlation_length_m: Annotated[float, Gt(0.0), Le(0.1)] = 2.4e-3
    """Distance at which that logarithm's correlation falls to 1/e (the longest of Jarvis and Cegla's)."""
    coupling_sd_db: Annotated[float, Ge(0.0), Le(20.0)] = 0.0
    """SD of a record's gain: couplant and wetting change."""
    bubble_probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.5
    """Probability that bubbles of the diffuser rise past the probe in a record (paper: it had one)."""
    bubbles_per_beam: Annotated[float, Ge(0.0), Le(1e4)] = 10.0
    """Mean number of bubbles in front of the spot then, over `liquid_depth_m` (assumption)."""
    bubble_radius_m: Annotated[float, Gt(0.0), Le(1e-2)] = 1e-3
    """Radius of a bubble (assumption: an aquarium's diffuser)."""
    liquid_depth_m: Annotated[float, Gt(0.0), Le(1.0)] = 10e-3
    """Depth of the liquid behind the wall that bubbles rise in (assumption)."""
    noise_rms_v: Annotated[float, Ge(0.0), Le(10.0)] = 0.01
    """RMS of one record before averaging, white (assumption); off with the other noise."""
    averages: Annotated[int, Ge(1), Le(1_000_000)] = 16
    """Records averaged by the receiver (assumption)."""
    gain_db: Annotated[float, Ge(-60.0), Le(120.0)] = 30.0
    """Receiver gain reported with a record; the volts above are behind it (assumption)."""
    range_v: Annotated[float, Gt(0.0), Le(1000.0)] = 1.0
    """Input range -range_v .. +range_v (assumption)."""
    resolution_bits: Annotated[int, Ge(8), Le(24)] = 14
    """Resolution of the receiver (that of the usual 100 MS/s PXI digitizer)."""

    def __post_init__(self) -> None:
        """Raise ValueError unless the centre frequency is below half the sample rate."""
        if self.centre_frequency_hz >= 0.5 * self.sample_rate_hz:
            raise ValueError(
                f"centre_frequency_hz is {self.centre_frequency_hz} Hz; it must be below half of "
                f"sample_rate_hz ({self.sample_rate_hz} Hz)"
            )
