"""Environmental and operational variability of a healthy rig at four levels: `twin.nuisance`.

``none`` is the twin of `ScatterParameters`, `DriftParameters` and `NoiseParameters` alone; a level comes on
top of them. No real record was at hand: every size is an assumption unless a source is named beside it,
and none is fitted to the paper's numbers. A changed size is another `TWIN_VERSION`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded, check_field_relation

NuisanceLevel = Literal["none", "laboratory", "workshop", "plant"]

STEEL_MODULUS_CHANGE_PER_K = -2.7e-4
"""Relative change of Young's modulus a kelvin (ASME BPVC II-D, table TM-1, carbon steel), chain and plate."""

LONGEST_MEMORY = 0.8
"""Of a source from set to set; beyond it the innovations of `processes.LAGS` sets no longer suffice."""


@bounded
class SourceParameters:
    """Source of scatter, in four parts that add up; the unit is the source's.

    With every set the source moves on as an AR(1) process, with every shot at random; it drifts slowly; and
    with every re-seat it has another place, above or below the nominal one, and stays there.
    """

    set_sd: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """SD from set to set."""
    memory: Annotated[float, Ge(0.0), Le(LONGEST_MEMORY)] = 0.0
    """Correlation of that part between neighbouring sets."""
    shot_sd: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """SD from shot to shot: each strike seats the chain anew."""
    wander_sd: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """SD of the slow wander."""
    reseat_sd: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """SD of the place after a re-seat."""


SOURCE_OF_NOTHING = SourceParameters()


@bounded
class NuisanceParameters:
    """Sizes of all sources of one level."""

    # Sources of scatter. Logarithms of a factor but for the tilt; independent for each contact and bead.
    contact_stiffness: SourceParameters = SOURCE_OF_NOTHING
    """ln A of each contact inside the chain: asperities, seat off the pole."""
    contact_damping: SourceParameters = SOURCE_OF_NOTHING
    """ln gamma of each contact inside the chain."""
    plate_stiffness: SourceParameters = SOURCE_OF_NOTHING
    """ln A of the coupling between last sphere and plate."""
    plate_damping: SourceParameters = SOURCE_OF_NOTHING
    """ln gamma of that coupling: film of dirt, grease or liquid."""
    bead_radius: SourceParameters = SOURCE_OF_NOTHING
    """ln of the radius of curvature that each bead turns to its neighbours: it rotates with each strike."""
    rubbing: SourceParameters = SOURCE_OF_NOTHING
    """ln of all dashpots alike: spheres rub the guide."""
    drop_height: SourceParameters = SOURCE_OF_NOTHING
    """ln of the striker's drop height: friction of its guide takes a part of the fall."""
    tilt_rad: SourceParameters = SOURCE_OF_NOTHING
    """Tilt of the sensor disk in rad."""
    gain: SourceParameters = SOURCE_OF_NOTHING
    """ln of the gain: bond of the PZT, cable, preamplifier."""

    tail_dof: Annotated[float, Gt(2.0), Le(1e3)] = 5.0
    """Degrees of freedom of Student's t, scaled to variance 1, of which shots and the innovations of sets are
    drawn: 5 has a kurtosis of 9, a normal one of 3."""
    shortest_wander_h: Annotated[float, Gt(0.0), Le(1e5)] = 48.0
    """Shortest period of the slow wander."""
    longest_wander_h: Annotated[float, Gt(0.0), Le(1e5)] = 1000.0
    """Longest period of the slow wander."""
    reseats_per_1000_h: Annotated[float, Ge(0.0), Le(1e3)] = 0.0
    """Mean number of re-seats of a chain in 1,000 h: somebody knocks against it, or takes it off and back."""
    rogue_probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Probability that a shot is rogue: a bead jams, the striker rubs."""
    rogue_stiffness_sd: Annotated[float, Ge(0.0), Le(2.0)] = 0.3
    """SD of ln A at the one contact that a rogue shot seats badly; its ln gamma grows with the same SD."""
    rogue_drop_loss: Annotated[float, Ge(0.0), Le(0.9)] = 0.3
    """Largest part of the drop height that a rogue shot loses, drawn evenly from 0."""

    day_amplitude_k: Annotated[float, Ge(0.0), Le(50.0)] = 0.0
    """Half the swing between night and day on top of `DriftParameters`, warmest at its hour."""
    season_amplitude_k: Annotated[float, Ge(0.0), Le(50.0)] = 0.0
    """Half the swing over a year of 8,766 h; the season at hour 0 is drawn."""
    process_sd_k: Annotated[float, Ge(0.0), Le(50.0)] = 0.0
    """SD of the plate's temperature about the room's: what flows behind it."""
    shortest_process_h: Annotated[float, Gt(0.0), Le(1e5)] = 4.0
    """Shortest period of the process."""
    longest_process_h: Annotated[float, Gt(0.0), Le(1e5)] = 72.0
    """Longest period of the process."""
    chain_share: Annotated[float, Ge(0.0), Le(1.0)] = 0.3
    """Part of the process temperature that reaches the chain."""
    modulus_change_per_k: Annotated[float, Ge(-1e-2), Le(1e-2)] = STEEL_MODULUS_CHANGE_PER_K
    """Relative change a kelvin of Young's modulus of chain and plate (ASME BPVC II-D, table TM-1)."""
    friction_per_k: Annotated[float, Ge(-0.05), Le(0.05)] = 0.0
    """Change a kelvin of ln drop height: play and grease of the striker's guide."""

    liquid_loss_fraction: Annotated[float, Ge(0.0), Le(0.9)] = 0.0
    """Part of the depth of `plate.liquid` that evaporates before it is topped up: 1 to 2 mm a day indoors."""
    refill_h: Annotated[float, Gt(0.0), Le(1e5)] = 168.0
    """Hours from one topping up to the next."""

    wear_per_1000_h: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Growth of all radii of curvature in 1,000 h: contacts flatten."""
    friction_per_1000_h: Annotated[float, Ge(0.0), Le(0.5)] = 0.0
    """Fall of ln drop height in 1,000 h: the guide wears."""
    ageing_per_decade: Annotated[float, Ge(0.0), Le(0.2)] = 0.0
    """Fall of ln gain in a decade of hours since poling (makers of soft PZT give 1 to 2 % a decade)."""
    hours_since_poling_h: Annotated[float, Gt(0.0), Le(1e6)] = 1000.0
    """Age of the PZT disk at hour 0."""
    scatter_growth_per_1000_h: Annotated[float, Ge(0.0), Le(10.0)] = 0.0
    """Growth in 1,000 h of every SD of set and shot, as a part of it: worn contacts seat less well."""

    noisy_hour_probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Probability that an hour is noisy, the same hours at all positions: welding, pumps, traffic."""
    noisy_factor: Annotated[float, Ge(1.0), Le(100.0)] = 2.0
    """Noise of a noisy hour over the usual one."""
    burst_probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Probability a shot of a noisy hour that an electrical burst, 0.1 to 1 MHz, rings in its record."""
    burst_v: Annotated[float, Ge(0.0), Le(10.0)] = 0.1
    """SD of its height at the digitizer's input."""
    knock_probability: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    """Probability a shot that something knocks at the structure: 2 to 12 kHz ring in its record."""
    knock_v: Annotated[float, Ge(0.0), Le(10.0)] = 0.1
    """SD of its height at the digitizer's input."""

    def __post_init__(self) -> None:
        """Raise ValueError if a longest period is below the shortest one."""
        check_field_relation(self, "longest_wander_h", "at least", "shortest_wander_h", " h")
        check_field_relation(self, "longest_process_h", "at least", "shortest_process_h", " h")


_FILE = Path(__file__).with_suffix(".toml")

NUISANCE: Mapping[str, NuisanceParameters] = {
    name: NuisanceParameters(
        **sizes | {key: SourceParameters(**size) for key, size in sizes.items() if isinstance(size, dict)}
    )
    for name, sizes in tomllib.loads(_FILE.read_text(encoding="utf-8")).items()
}
"""The levels by name; ``none`` has none."""
