"""Change settings of the assessment of a stored test: ``--set KEY=VALUE``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

from daq_service.errors import UsageError
from daq_service.settings.stored import rename_old_keys, restore_settings
from daq_service.settings.tables import KeyPath, flatten, nest_tables
from daq_service.settings.tree import Settings

ASSESSMENT_KEYS: Mapping[str, frozenset[str] | None] = {
    "features": None,
    "ultrasound": None,
    "baseline": None,
    "novelty": None,
    "alarms": None,
    "quality": frozenset({"no_data_sets", "retire_after_sets"}),
}
"""Tables of the configuration about the assessment, and their keys (None: all). Others concern acquisition,
storage or display, which a reassessment does not change."""


def list_assessment_keys() -> list[str]:
    """List the names ``table.key`` of all keys of the assessment that ``--set`` may change."""
    return [
        f"{table}.{key}"
        for table, keys in ASSESSMENT_KEYS.items()
        for key in _find_settings_class(table).model_fields
        if keys is None or key in keys
    ]


def parse_assignments(texts: Sequence[str]) -> dict[KeyPath, Any]:
    """Parse texts ``KEY=VALUE`` to values by key path: a value is JSON, or else taken as text.

    Raises
    ------
    UsageError
        Not of this form, twice the same key, or a key that does not concern the assessment.
    """
    found: dict[KeyPath, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        path = tuple(key.strip().split("."))
        if not equals or not all(path):
            raise UsageError(f"--set {text}: write KEY=VALUE, for example alarms.decides_by=chart")
        if len(path) < 2 or path[0] not in ASSESSMENT_KEYS or path[1] not in _list_key_names(path[0]):
            raise UsageError(
                f"--set {'.'.join(path)}: this key is unknown, or does not affect the assessment; "
                f"these do: {', '.join(list_assessment_keys())}"
            )
        if path in found:
            raise UsageError(f"--set {'.'.join(path)} is given twice; leave one out")
        try:
            found[path] = json.loads(value)
        except ValueError:
            found[path] = value
    return found


def apply_setting_changes(configuration: Mapping[str, Any], given: Mapping[KeyPath, Any]) -> Settings:
    """Build the settings of a stored configuration with the given values in place of its own.

    Raises
    ------
    UsageError
        A value is refused: key, value, bound.
    """
    stored_values = flatten(rename_old_keys(configuration)).items()
    try:
        return restore_settings(
            nest_tables({p: v for p, v in stored_values if not _is_replaced(p, given)} | dict(given))
        )
    except ValidationError as error:
        lines = [
            f"{'.'.join(map(str, one['loc']))}: {one['msg'].removeprefix('Value error, ')} "
            f"(value: {one['input']!r})"
            for one in error.errors()
        ]
        raise UsageError(f"--set is refused: {'; '.join(lines)}") from error


def _is_replaced(path: KeyPath, given: Mapping[KeyPath, Any]) -> bool:
    """Return whether a given key is the key at ``path``, a parent or a child of it."""
    return any(path[: len(one)] == one or one[: len(path)] == path for one in given)


def _list_key_names(table: str) -> frozenset[str]:
    """List the keys of a table that affect the assessment; KeyError for another table."""
    return ASSESSMENT_KEYS[table] or frozenset(_find_settings_class(table).model_fields)


def _find_settings_class(name: str) -> type[BaseModel]:
    """Return the model class of a top-level table of the settings; KeyError if there is none."""
    kind = Settings.model_fields[name].annotation
    assert isinstance(kind, type) and issubclass(kind, BaseModel), "a table of the configuration"  # noqa: PT018
    return kind
