"""Warnings about simulated shots: contacts that yield, overlapping waves, records that are too short."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence

import click

from analysis.waves.record_reduction import ExtractionSettings
from analysis.waves.transducer import LEAST_TOF_WIDTHS, find_obstacles, settings_of_chain
from daq_service.acquisition.shot_features import describe_chain
from daq_service.errors import UsageError
from daq_service.settings.tree import PositionSettings
from simulator.chain.contact_pressure import FIRST_YIELD
from simulator.parameters.chain import ChainParameters


def find_shot_warnings(
    chain: ChainParameters,
    numbers: Mapping[str, float | None],
    after_trigger_s: float,
    place: PositionSettings | None = None,
) -> list[str]:
    """Find contacts of a shot that yield, and waves that cannot be assessed; each with value and limit.

    Parameters
    ----------
    numbers
        Results of the shot (`daq_service.cli.sweep.shot.RESULTS`); None or NaN where there is none.
    after_trigger_s
        Length of a record after its trigger.
    place
        Whose ``waves`` keys have priority for its own chain; None: the test's, which has none.
    """
    found = []
    for name, where in (("plate", "at the plate"), ("sphere", "in the chain")):
        ratio, pressure_pa = numbers.get(f"{name}_yield_ratio"), numbers.get(f"{name}_pressure_pa")
        if ratio is not None and pressure_pa is not None and ratio > 1.0:
            found.append(
                f"the peak pressure {where} is {1e-9 * pressure_pa:.2f} GPa, {ratio:.2f} times that of first "
                f"yield ({FIRST_YIELD} times the yield strength): drop from less height, or set "
                "yield_strength_pa of a stronger material"
            )
    reflected = numbers.get("dynamic_amplitude_ratio", numbers["amplitude_ratio"])
    description = describe_chain(chain)
    given = place.waves.model_dump(exclude_none=True) if place is not None and place.chain == chain else {}
    overlap = description.tof_widths < LEAST_TOF_WIDTHS  # then there are no windows to derive
    # The coupled model has no inelasticity: its amplitude ratio shows what the plate takes.
    return found + find_obstacles(
        description,
        ExtractionSettings() if overlap else settings_of_chain(description, **given),
        inelasticity=numbers.get("inelasticity") or 0.0,
        amplitude_ratio=math.inf if reflected is None or math.isnan(reflected) else reflected,
        after_trigger_s=after_trigger_s,
    )


def summarise_warnings(by_shot: Sequence[Sequence[str]]) -> list[str]:
    """Return each kind of warning once, as of the first shot that has it, with the number of such shots."""
    kinds = defaultdict(list)
    for text in (text for texts in by_shot for text in texts):
        kinds[re.sub(r"\d", "", text)].append(text)
    if len(by_shot) == 1:
        return [text for (text,) in kinds.values()]
    return [f"{len(texts)} of {len(by_shot)} shots; in the first, {texts[0]}" for texts in kinds.values()]


def report_warnings(warnings: Sequence[str], *, strict: bool, as_json: bool) -> None:
    """Print warnings on standard error, unless they are in the JSON; raise UsageError for any if `strict`."""
    if strict and warnings:
        raise UsageError("\n".join(["with --strict, warnings are errors:", *warnings]))
    for text in () if as_json else warnings:
        click.echo(f"WARNING: {text}", err=True)
