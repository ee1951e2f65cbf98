"""NI's scaling properties as one polynomial of the raw values.

A channel's raw values become physical ones through numbered scales ``NI_Scale[i]_...``; the last one
gives the result, and each names its input: the raw values or an earlier scale. Scales that are
polynomials (linear, polynomial, sums and differences of them) are composed into one; a single one keeps
its coefficients to the last bit. Others (tables, thermocouples, bridges) are refused: counts under such
a scale are no volts of an ADC.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyadd, polysub
from numpy.typing import NDArray

Polynomial = NDArray[np.float64]
"""Coefficients, constant first, shape (order + 1,)."""

RAW = 0xFFFFFFFF
"""Input source that stands for the raw values."""
_SCALE_TYPE = re.compile(r"NI_Scale\[(\d+)\]_Scale_Type")
_LARGEST_ORDER = 32
"""NI writes polynomials of order 3; a composition beyond this is a damaged file."""


class ScalingError(ValueError):
    """Error: the scaling is no polynomial of the raw values, with the reason."""


def build_raw_polynomial(properties: Mapping[str, Any]) -> Polynomial | None:
    """Build the polynomial that gives the physical value from the raw one, from NI's scaling properties.

    Returns
    -------
    ndarray or None
        Coefficients, constant first, shape (order + 1,), order >= 1. None if there are no scales, or they
        were applied before the file was written (``NI_Scaling_Status`` is ``scaled``).

    Raises
    ------
    ScalingError
        A scale is no polynomial, lacks a property or an earlier scale as input, or the result is constant or
        not finite.
    """
    count = _count_scales(properties)
    if count == 0 or properties.get("NI_Scaling_Status", "unscaled") == "scaled":
        return None
    coefficients = _read_scale(count - 1, properties, limit=count)
    if coefficients.size < 2:
        raise ScalingError("the scaling is a constant: every raw value has the same meaning")
    if not np.isfinite(coefficients).all():
        raise ScalingError(f"the scaling has coefficients that are not finite: {coefficients.tolist()}")
    return coefficients


def _count_scales(properties: Mapping[str, Any]) -> int:
    """Return the number of scales: its own property, else the highest number of a scale + 1; 0 without any.

    ValueError or TypeError if the property is no number.
    """
    if "NI_Number_Of_Scales" in properties:
        return int(properties["NI_Number_Of_Scales"])
    return max(
        (int(match[1]) + 1 for name in properties if (match := _SCALE_TYPE.fullmatch(name))), default=0
    )


def _read_scale(source: int, properties: Mapping[str, Any], *, limit: int) -> Polynomial:
    """Return the output of scale number ``source`` (`RAW`: the raw values) as a polynomial of the raw values.

    Raise ScalingError for an input that is not an earlier scale (below ``limit``), a missing property, or a
    scale that is no polynomial.
    """
    identity = np.array([0.0, 1.0])
    if source == RAW:
        return identity
    if not 0 <= source < limit:
        raise ScalingError(f"a scale takes its input from scale {source}, which is not before it")
    prefix = f"NI_Scale[{source}]_"
    kind = properties.get(f"{prefix}Scale_Type")
    if kind is None:
        # The scaler of DAQmx raw data has a number, but no properties: it hands over the raw values.
        return identity

    def resolve_input(name: str) -> Polynomial:
        """Return the polynomial of this scale's named input; that of the raw values if it names none.

        Raise ScalingError as the enclosing function does.
        """
        return _read_scale(int(properties.get(f"{prefix}{name}_Input_Source", RAW)), properties, limit=source)

    if kind == "Linear":
        own = np.array(
            [
                _parse_number(properties, f"{prefix}Linear_Y_Intercept"),
                _parse_number(properties, f"{prefix}Linear_Slope"),
            ]
        )
        return _compose_polynomials(own, resolve_input("Linear"))
    if kind == "Polynomial":
        size = int(properties.get(f"{prefix}Polynomial_Coefficients_Size", 4))
        names = [f"{prefix}Polynomial_Coefficients[{index}]" for index in range(size)]
        own = np.array([_parse_number(properties, name) for name in names])
        return _compose_polynomials(own, resolve_input("Polynomial"))
    if kind == "AdvancedAPI":
        return resolve_input("AdvancedAPI")
    if kind in ("Add", "Subtract"):
        left, right = resolve_input(f"{kind}_Left_Operand"), resolve_input(f"{kind}_Right_Operand")
        # NI subtracts the left operand from the right one.
        total = polyadd(left, right) if kind == "Add" else polysub(right, left)
        return np.asarray(total, dtype=np.float64)
    raise ScalingError(f"scale {source} is of type {kind!r}, which is no polynomial")


def _compose_polynomials(outer: Polynomial, inner: Polynomial) -> Polynomial:
    """Compose two polynomials, outer(inner(x)); an identity as ``inner`` returns ``outer`` unchanged.

    Coefficients are constant first. Raise ScalingError if the order exceeds `_LARGEST_ORDER`.
    """
    if inner.tolist() == [0.0, 1.0]:
        return outer
    if (outer.size - 1) * (inner.size - 1) > _LARGEST_ORDER:
        raise ScalingError(f"the scales compose to an order above {_LARGEST_ORDER}")
    result = np.zeros(1)
    for coefficient in outer[::-1]:
        result = np.convolve(result, inner)
        result[0] += coefficient
    return result[: (outer.size - 1) * (inner.size - 1) + 1]


def _parse_number(properties: Mapping[str, Any], name: str) -> float:
    """Parse a property as a float; ScalingError if it is missing or no number."""
    try:
        return float(properties[name])
    except KeyError as error:
        raise ScalingError(f"the property {name} is missing") from error
    except (TypeError, ValueError) as error:
        raise ScalingError(f"the property {name} is {properties[name]!r}, no number") from error
