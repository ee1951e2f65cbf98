"""Names of tests in addresses."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

LONGEST_NAME = 60


def build_slug(text: str) -> str:
    """Build a slug of lower-case letters, digits and hyphens, at most 60 characters, from the name of a test.

    ``Größe: Loch Nr. 2`` becomes ``grosse-loch-nr-2``; "test" if no such character remains.
    """
    plain = unicodedata.normalize("NFKD", text.casefold()).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", "-", plain)[:LONGEST_NAME].strip("-") or "test"


def build_unique_slugs(texts: Iterable[str]) -> list[str]:
    """Build one slug for each text, in order; a repeated one gets a number as suffix, starting with 2."""
    names: list[str] = []
    for text in texts:
        plain = name = build_slug(text)
        number = 1
        while name in names:
            number += 1
            name = f"{plain}-{number}"
        names.append(name)
    return names
