"""List the arrays that a design compares: other spheres, positions of the sensor, drop heights and loads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import product

from pydantic import TypeAdapter

from daq_service.cli.sweep.specification import parse_axis
from daq_service.errors import UsageError
from daq_service.shared_file import load_module_toml
from simulator.parameters.chain import ChainParameters

MATERIALS = TypeAdapter(dict[str, dict[str, float]]).validate_python(load_module_toml(__file__))
"""Keys of a chain by material, and the density."""
USUAL_SWEEPS = (
    f"material={','.join(MATERIALS)}",
    "diameter_m=6.35e-3,9.525e-3,12.7e-3,15.875e-3,19.05e-3,22.225e-3,25.4e-3,28.575e-3,31.75e-3,38.1e-3",
    "precompression_n=0,20,30,40,50",
)
"""Varied if nothing else is given; the diameters are those of bearing balls, in eighths of an inch."""


def make_chain(
    chain: ChainParameters, *, material: str | None = None, diameter_m: float | None = None, **keys: object
) -> ChainParameters:
    """Return a chain with other spheres or keys; the sensor's mass goes with that of a sphere.

    Raises KeyError for an unknown material, and TypeError or ValueError for an invalid value.
    """
    radius_m = chain.radius_m if diameter_m is None else 0.5 * diameter_m
    moduli = {} if material is None else dict(MATERIALS[material])
    own_density = chain.mass_kg / (4.0 / 3.0 * math.pi * chain.radius_m**3)
    heavier = moduli.pop("density_kg_per_m3", own_density) / own_density * (radius_m / chain.radius_m) ** 3
    names = ("mass_kg", "sensor_mass_kg")
    masses = {name: float(f"{heavier * getattr(chain, name):.4g}") for name in names}
    return replace(chain, **{"radius_m": radius_m, **masses, **moduli, **keys})  # type: ignore[arg-type] # checked


def list_chains(chain: ChainParameters, sweeps: Sequence[str]) -> dict[str, ChainParameters]:
    """List the chains of all combinations of varied values, by a description of what differs.

    Parameters
    ----------
    sweeps
        ``KEY=VALUES`` as for `solimon simulate`; a key is ``material``, ``diameter_m`` or a number of
        ``[chain]``. Empty: `USUAL_SWEEPS`.

    Raises
    ------
    UsageError
        An invalid sweep, key or value, or a configured chain of different spheres.
    """
    if chain.spheres:
        raise UsageError("chain.spheres describes bodies that differ; arrays of a design have equal spheres")
    axes = [parse_axis(text) for text in sweeps or USUAL_SWEEPS]
    known = {"material", "diameter_m"} | {one.name for one in fields(chain)} - {"spheres"}
    if unknown := {axis.key for axis in axes} - known:
        raise UsageError(f"--sweep {min(unknown)} is none of {', '.join(sorted(known))}")
    found = {}
    for values in product(*(axis.values for axis in axes)):
        given = dict(zip((axis.key for axis in axes), values, strict=True))
        try:
            found[_describe(given)] = make_chain(chain, **given)  # type: ignore[arg-type] # checked there
        except KeyError as error:
            raise UsageError(f"no material {error}; there are {', '.join(MATERIALS)}") from error
        except (TypeError, ValueError) as error:
            raise UsageError(f"--sweep: {error}") from error
    return found


def _describe(given: Mapping[str, object]) -> str:
    """Return what differs in a chain, as "steel 25.4 mm, precompression_n 50"."""
    words = [str(given["material"])] if "material" in given else []
    if "diameter_m" in given:
        words.append(f"{1e3 * float(str(given['diameter_m'])):.4g} mm")
    rest = {key: value for key, value in given.items() if key not in ("material", "diameter_m") and value}
    return ", ".join(filter(None, (" ".join(words), *(f"{key} {value}" for key, value in rest.items()))))
