"""Format of answers: JSON with null for "not available", RFC 3339 times, and ages."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence

import numpy as np
import orjson
from starlette.responses import JSONResponse

from daq_service.clock import format_utc
from hardware_drivers.nanoseconds import NS_PER_S


class JsonAnswer(JSONResponse):
    """JSON response by orjson: NaN and infinities become null, NumPy arrays become lists.

    A subclass of `JSONResponse`, by which FastAPI knows that the response model describes the body.
    """

    def render(self, content: object) -> bytes:
        """Encode the content as JSON in UTF-8; raise TypeError for a type that orjson does not know."""
        return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)


def build_framed_body(header: object, *parts: bytes) -> bytes:
    """Join a header and binary parts: u32 length (little-endian), JSON padded to 8 bytes, then the parts.

    The parts start at a multiple of 8 bytes. Raises ValueError for NaN or infinity in the header.
    """
    text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(4 + len(text)) % 8)
    return b"".join([struct.pack("<I", len(text)), text, *parts])


def format_rfc3339(utc_ns: int | None) -> str | None:
    """Format nanoseconds of UTC as RFC 3339 text without loss, e.g. ``2024-01-01T00:30:00.000000250Z``.

    It has 0, 3, 6 or 9 decimals, as few as are exact. None stays None.
    """
    if utc_ns is None:
        return None
    decimals = 9 if utc_ns % 1000 else 6 if utc_ns % 1_000_000 else 3 if utc_ns % NS_PER_S else 0
    return format_utc(utc_ns, decimals)


def format_hour_as_rfc3339(epoch_utc_ns: int, hour: float) -> str | None:
    """Format an hour of the test as RFC 3339 text, rounded to whole seconds after the epoch.

    Raises ValueError for NaN and OverflowError for infinity.
    """
    return format_rfc3339(epoch_utc_ns + round(hour * 3600.0) * NS_PER_S)


def format_hours_as_rfc3339(epoch_utc_ns: int, hours: Sequence[float]) -> list[str]:
    """Format a column of hours as RFC 3339 texts in one step, as `format_hour_as_rfc3339` does for one.

    The hours must be finite.
    """
    if not hours:
        return []
    whole, rest = divmod(epoch_utc_ns, NS_PER_S)
    seconds = whole + np.rint(np.asarray(hours) * 3600.0).astype(np.int64)
    # A whole number of seconds leaves the fraction of the epoch as it is.
    fraction = str(format_rfc3339(rest))[len("1970-01-01T00:00:00") :]
    return [f"{stamp}{fraction}" for stamp in np.datetime_as_string(seconds.astype("datetime64[s]")).tolist()]


def add_utc(row: Mapping[str, object], epoch_utc_ns: int) -> dict[str, object]:
    """Copy a row for an answer with RFC 3339 times added to its hours and instead of its nanoseconds.

    ``*_utc_ns`` becomes ``*_utc`` (JavaScript cannot hold the integers), and each hour of the
    experiment ``*_h`` gets its ``*_utc`` unless the row has one already; both are None without a number.
    """
    answer: dict[str, object] = {}
    for key, value in row.items():
        if key == "utc_ns" or key.endswith("_utc_ns"):
            answer[key.removesuffix("_ns")] = format_rfc3339(value) if isinstance(value, int) else None
        else:
            answer[key] = value
    for key in [key for key in answer if key.endswith("_h")]:
        hours = answer[key]
        stamp = format_hour_as_rfc3339(epoch_utc_ns, hours) if isinstance(hours, int | float) else None
        answer.setdefault(key.removesuffix("_h") + "_utc", stamp)
    return answer
