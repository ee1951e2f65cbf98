"""Normal float32 numbers of an SFC64 generator as NumPy's, at a fraction of their cost.

NumPy reaches its generator through a pointer, number by number. Here the generator and the ziggurat of 256
layers (Marsaglia and Tsang 2000, doi:10.18637/jss.v005.i08) are one loop. Numbers, and the state in which
the generator is left, are NumPy's; only beyond the last layer, at 3.65, may a logarithm be rounded otherwise.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.numerics.machine_code import jit_compile

LAYERS = 256
LAST_EDGE = 3.6541528853610088
"""Where the last of so many layers of equal area ends and the tail begins."""
STEPS = 1 << 23
"""Places within a layer: a number takes 23 of the 32 bits for it, 8 for the layer and one for its sign."""

Table = NDArray[np.float32]
Words = NDArray[np.uint64]


def draw_standard_normals(random: np.random.Generator, n: int) -> Table:
    """Draw n standard normal float32 numbers, as NumPy's generator does; fast from an SFC64.

    The generator's state advances as with NumPy's own method.
    """
    bits = random.bit_generator
    if not isinstance(bits, np.random.SFC64):
        return random.standard_normal(n, dtype=np.float32)
    state: Any = bits.state
    words = np.empty(6, dtype=np.uint64)
    words[:4], words[4], words[5] = state["state"]["state"], state["has_uint32"], state["uinteger"]
    drawn = np.empty(n, dtype=np.float32)
    _fill_with_normals(words, *_build_ziggurat(), drawn)
    state["state"]["state"], state["has_uint32"], state["uinteger"] = words[:4], int(words[4]), int(words[5])
    bits.state = state
    return drawn


@cache
def _build_ziggurat() -> tuple[NDArray[np.uint32], Table, Table]:
    """Compute the ziggurat's three tables for 256 layers, the lowest layer first.

    Steps fully under the curve, shape (256,); a step's signed width, positive then negative, shape (512,);
    the curve's height, shape (256,).
    """
    area = LAST_EDGE * math.exp(-0.5 * LAST_EDGE**2) + math.sqrt(0.5 * math.pi) * math.erfc(
        LAST_EDGE / math.sqrt(2.0)
    )
    edges = np.empty(LAYERS + 1)
    edges[0], edges[-1] = 0.0, area / math.exp(-0.5 * LAST_EDGE**2)
    edges[-2] = LAST_EDGE
    for k in range(LAYERS - 2, 0, -1):
        edges[k] = math.sqrt(-2.0 * math.log(area / edges[k + 1] + math.exp(-0.5 * edges[k + 1] ** 2)))
    # The first number of a table is of the lowest layer, which holds the tail, too.
    inside = np.rint(np.append(edges[-2] / edges[-1], edges[:-2] / edges[1:-1]) * STEPS)
    widths = np.append(edges[-1], edges[1:-1]) / STEPS
    heights = np.exp(-0.5 * edges[:-1] ** 2)
    widths = np.append(widths, -widths)
    return inside.astype(np.uint32), widths.astype(np.float32), heights.astype(np.float32)


@jit_compile(error_model="numpy")
def _draw_uint32(words: Words) -> Any:
    """Return the next 32 bits of an SFC64 and advance its state in ``words``."""
    if words[4]:
        words[4] = np.uint64(0)
        return np.uint32(words[5])
    given = words[0] + words[1] + words[3]
    words[3] += np.uint64(1)
    words[0] = words[1] ^ (words[1] >> np.uint64(11))
    words[1] = words[2] + (words[2] << np.uint64(3))
    words[2] = ((words[2] << np.uint64(24)) | (words[2] >> np.uint64(40))) + given
    words[4], words[5] = np.uint64(1), given >> np.uint64(32)
    return np.uint32(given & np.uint64(0xFFFFFFFF))


@jit_compile(error_model="numpy")
def _draw_from_tail(words: Words, bits: np.uint32) -> Any:
    """Draw a normal number beyond the last edge (Marsaglia 1964); bit 17 of ``bits`` is the sign."""
    while True:
        first = np.float32(_draw_uint32(words) >> np.uint32(8)) * np.float32(2.0**-24)
        second = np.float32(_draw_uint32(words) >> np.uint32(8)) * np.float32(2.0**-24)
        x = -np.float32(1.0 / LAST_EDGE) * np.float32(math.log1p(-np.float64(first)))
        y = -np.float32(math.log1p(-np.float64(second)))
        if y + y > x * x:
            x = np.float32(LAST_EDGE) + x
            return -x if (bits >> np.uint32(17)) & np.uint32(1) else x


@jit_compile(error_model="numpy")
def _fill_with_normals(
    words: Words, inside: NDArray[np.uint32], widths: Table, heights: Table, drawn: Table
) -> None:
    """Fill `drawn`, shape (n,), with standard normal numbers and advance the state in ``words``.

    ``words`` holds SFC64's four state words, whether half of a fifth is kept, and that half.
    """
    size = drawn.shape[0]
    done = 0
    while done < size:
        if words[4] or done + 1 == size:
            drawn[done] = _draw_normal(words, _draw_uint32(words), inside, widths, heights)
            done += 1
            continue
        # Two numbers of each word, which stays in registers, as long as all lie well inside their layers.
        s0, s1, s2, counter = words[0], words[1], words[2], words[3]
        low = high = np.uint32(0)
        first = second = np.float32(0.0)
        low_inside = high_inside = True
        while done + 1 < size:
            given = s0 + s1 + counter
            counter += np.uint64(1)
            s0 = s1 ^ (s1 >> np.uint64(11))
            s1 = s2 + (s2 << np.uint64(3))
            s2 = ((s2 << np.uint64(24)) | (s2 >> np.uint64(40))) + given
            low, high = np.uint32(given & np.uint64(0xFFFFFFFF)), np.uint32(given >> np.uint64(32))
            first, low_inside = _convert_bits_to_number(low, inside, widths)
            if not low_inside:
                break
            second, high_inside = _convert_bits_to_number(high, inside, widths)
            drawn[done] = first
            if not high_inside:
                break
            drawn[done + 1] = second
            done += 2
        words[0], words[1], words[2], words[3], words[5] = s0, s1, s2, counter, np.uint64(high)
        if not low_inside:
            words[4] = np.uint64(1)
            drawn[done] = _draw_normal(words, low, inside, widths, heights)
            done += 1
        elif not high_inside:
            drawn[done + 1] = _draw_normal(words, high, inside, widths, heights)
            done += 2


@jit_compile(error_model="numpy")
def _convert_bits_to_number(bits: np.uint32, inside: NDArray[np.uint32], widths: Table) -> Any:
    """Convert 32 bits to a number, and whether the curve is above all of its layer there (accept at once)."""
    layer = bits & np.uint32(LAYERS - 1)
    place = bits >> np.uint32(9)
    return np.float32(place) * widths[bits & np.uint32(2 * LAYERS - 1)], place < inside[layer]


@jit_compile(error_model="numpy")
def _draw_normal(
    words: Words, bits: np.uint32, inside: NDArray[np.uint32], widths: Table, heights: Table
) -> Any:
    """Draw a standard normal number from 32 bits; draw further bits while it is rejected."""
    while True:
        x, under = _convert_bits_to_number(bits, inside, widths)
        if under:
            return x
        layer = bits & np.uint32(LAYERS - 1)
        if layer == 0:
            return _draw_from_tail(words, bits)
        even = np.float32(_draw_uint32(words) >> np.uint32(8)) * np.float32(2.0**-24)
        height = (heights[layer - 1] - heights[layer]) * even + heights[layer]
        if height < math.exp(-0.5 * np.float64(x) * np.float64(x)):
            return x
        bits = _draw_uint32(words)
