"""Names of tests in addresses."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

LONGEST_NAME = 60


def build_url_name(text: str) -> str:
    """Build a URL name of lower-case letters, digits and hyphens; "test" if no such character remains.

    At most 60 characters.

    >>> build_url_name("Größe: Loch Nr. 2")
    'grosse-loch-nr-2'
    """
    plain = unicodedata.normalize("NFKD", text.casefold()).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", "-", plain)[:LONGEST_NAME].strip("-") or "test"


def build_unique_url_names(texts: Iterable[str]) -> list[str]:
    """Build one URL name for each text, in order.

    A repeated name gets a number as suffix, starting with 2.
    """
    names: list[str] = []
    for text in texts:
        plain = name = build_url_name(text)
        number = 1
        while name in names:
            number += 1
            name = f"{plain}-{number}"
        names.append(name)
    return names
