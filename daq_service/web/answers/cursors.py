"""Opaque cursors for the end of a page, tied to its listing and filters."""

from __future__ import annotations

import base64
import hashlib

from daq_service.web.answers.problem import Problem


def encode_cursor(listing: str, after: int) -> str:
    """Encode the number of the last row of a page as URL-safe text.

    ``listing`` names the resource and its filters, to which the cursor is tied.
    """
    mark = hashlib.sha256(listing.encode()).hexdigest()[:8]
    return base64.urlsafe_b64encode(f"{mark}.{after}".encode()).decode().rstrip("=")


def decode_cursor(listing: str, cursor: str | None) -> int | None:
    """Decode a cursor to the number of the row after which a page starts; None for the first page.

    ``listing`` is that of `encode_cursor`.

    Raises
    ------
    Problem
        422: not a cursor of this listing with these filters.
    """
    if cursor is None:
        return None
    try:
        text = base64.urlsafe_b64decode(cursor.encode() + b"=" * (-len(cursor) % 4)).decode()
        number = int(text.partition(".")[2])
    except ValueError:
        number = -1
    if number < 0 or encode_cursor(listing, number) != cursor:
        raise Problem(
            "invalid-cursor",
            f"cursor is {cursor!r}; it is none that this listing gave out with these filters.",
        )
    return number
