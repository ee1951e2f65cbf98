"""How answers look: JSON with null for "not available", RFC 3339 times, age beside the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import orjson
from starlette.responses import JSONResponse

NS_PER_S = 1_000_000_000
NS_PER_H = 3600 * NS_PER_S


class JsonAnswer(JSONResponse):
    """JSON by orjson: NaN and infinities become null, NumPy arrays become lists.

    A subclass of `JSONResponse`, by which FastAPI knows that the response model describes the body.
    """

    def render(self, content: Any) -> bytes:
        """Encode."""
        return orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)


def rfc3339(utc_ns: int | None) -> str | None:
    """Nanoseconds of UTC as RFC 3339 text without loss, e.g. ``2024-01-01T00:30:00.000000250Z``."""
    if utc_ns is None:
        return None
    whole, rest = divmod(utc_ns, NS_PER_S)
    text = datetime.fromtimestamp(whole, tz=UTC).strftime("%Y-%m-%dT%H:%M:%S")
    if rest:
        digits = f"{rest:09d}"
        text += "." + (
            digits[:3] if digits.endswith("000000") else digits[:6] if digits.endswith("000") else digits
        )
    return text + "Z"


def with_utc(row: Mapping[str, Any], epoch_utc_ns: int) -> dict[str, Any]:
    """Row as it leaves the service.

    ``*_utc_ns`` becomes ``*_utc`` (JavaScript cannot hold the integers), and each hour of the
    experiment ``*_h`` gets its ``*_utc`` unless the row has one already.
    """
    answer: dict[str, Any] = {}
    for key, value in row.items():
        if key == "utc_ns" or key.endswith("_utc_ns"):
            answer[key.removesuffix("_ns")] = rfc3339(value)
        else:
            answer[key] = value
    for key in [key for key in answer if key.endswith("_h")]:
        hours = answer[key]
        stamp = None if hours is None else rfc3339(epoch_utc_ns + round(hours * 3600.0) * NS_PER_S)
        answer.setdefault(key.removesuffix("_h") + "_utc", stamp)
    return answer
