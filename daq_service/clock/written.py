"""Times as people write them: RFC 3339, UTC."""

from __future__ import annotations

from datetime import UTC, datetime

from hardware_drivers.nanoseconds import NS_PER_S


def parse_utc(text: str) -> int:
    """Parse an RFC 3339 time with a UTC offset to integer nanoseconds of UTC, with a resolution of 1 µs.

    Raises
    ------
    ValueError
        The text is not a time, or has no offset.
    """
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError(f"{text!r} has no UTC offset; write it like 2024-01-01T00:00:00Z")
    delta = moment.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    return (delta.days * 86_400 + delta.seconds) * NS_PER_S + delta.microseconds * 1000


def format_utc(utc_ns: int, decimals: int = 9) -> str:
    """Format integer nanoseconds of UTC as RFC 3339 (ISO 8601) with the suffix ``Z``.

    The seconds are truncated to ``decimals`` digits (0 to 9), not rounded.
    """
    whole, rest = divmod(utc_ns, NS_PER_S)
    stamp = datetime.fromtimestamp(whole, tz=UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return stamp + (f".{rest:09d}"[: decimals + 1] if decimals else "") + "Z"
