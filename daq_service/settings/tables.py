"""Nested tables of a configuration file, and the same keys as paths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

KeyPath = tuple[str, ...]
Tables = dict[str, Any]
"""Tables as a file has them: their values have no type before they are validated as settings."""


def flatten(values: Mapping[str, object], above: KeyPath = ()) -> dict[KeyPath, object]:
    """Flatten nested tables to key path and value, in order; empty tables and lists count as values."""
    flat: dict[KeyPath, object] = {}
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            flat |= flatten(value, (*above, name))
        else:
            flat[*above, name] = value
    return flat


def nest_tables(values: Mapping[KeyPath, object]) -> Tables:
    """Build nested tables from values by key path; the inverse of `flatten`."""
    tree: Tables = {}
    for path, value in values.items():
        below = tree
        for name in path[:-1]:
            below = below.setdefault(name, {})
        below[path[-1]] = value
    return tree


def remove_keys(values: Mapping[str, object], paths: frozenset[str]) -> Tables:
    """Return a copy of nested tables without the keys or tables at these dotted paths.

    Unknown paths are ignored.
    """
    kept = {}
    for name, value in values.items():
        if name in paths:
            continue
        below = frozenset(path.removeprefix(f"{name}.") for path in paths if path.startswith(f"{name}."))
        kept[name] = remove_keys(value, below) if below and isinstance(value, Mapping) else value
    return kept
