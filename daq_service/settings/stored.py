"""The configuration that a data folder keeps, read by today's keys and compared with the one given.

A folder outlives versions. A key that came later counts with its default, or with what was done before it
came (`BEFORE`); one that got another name or went is looked up in `RENAMED`. What then differs, differs in
what is measured.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache

from pydantic import ValidationError

from daq_service.settings.instruments import ParametersError, fill_instrument_defaults
from daq_service.settings.tables import KeyPath, Tables, flatten, nest_tables
from daq_service.settings.tree import HASHED_OUT, Settings
from hardware_drivers.errors import ConfigurationError

RENAMED: Mapping[str, str | None] = {
    f"rig.{table}.unwatched_s": f"rig.{table}.watchdog_timeout_s" for table in ("supply", "drive")
}
"""Keys or tables of earlier versions: dotted path (``*``: any one name) to today's path with as many ``*``,
or None for one that went without changing what is measured."""

BEFORE: Mapping[str, object] = {"alarms.decides_by": "k_of_n"}
"""Keys that came later and whose default is not what was done before, with what was."""

PRIVATE = ("web", "notifications", "storage")
"""Tables with addresses, secrets and paths: no reader of the data needs them."""

SHOWN = 12
"""A refusal names this many keys."""


@cache
def _get_stored_settings_class() -> type[Settings]:
    """Return the settings class that ignores the environment; created on the first call, then cached."""

    class Stored(Settings):
        """The environment belongs to today's start."""

        reads_environment = False

    return Stored


def restore_settings(values: Mapping[str, object]) -> Settings:
    """Validate a stored configuration with its old keys renamed and without the current environment.

    Raises
    ------
    ValidationError
        This version does not accept the stored configuration.
    """
    return _get_stored_settings_class()(**rename_old_keys(values))


def rename_old_keys(values: Mapping[str, object]) -> Tables:
    """Return a copy of nested tables with current key names (`RENAMED`); removed keys are left out.

    Absent keys of `BEFORE` get their earlier value if their table is present.
    """
    # What a version wrote has all its tables; one that a person wrote and left out means today's defaults.
    before = {path: value for key, value in BEFORE.items() if (path := tuple(key.split(".")))[0] in values}
    moved = ((_find_current_path(path), value) for path, value in flatten(values).items())
    return nest_tables(before | {path: value for path, value in moved if path})


def remove_private_keys(values: Tables) -> Tables:
    """Return a copy of a stored configuration for publication: without `PRIVATE` and contacts of alarms."""
    public = {name: value for name, value in values.items() if name not in PRIVATE}
    if "alarms" in public:
        public["alarms"] = {name: value for name, value in public["alarms"].items() if name != "contacts"}
    return public


def list_settings_differences(stored: Mapping[str, object], given: Settings) -> list[str]:
    """List the keys that affect the data and differ between a stored and the given configuration.

    Parameters
    ----------
    stored
        Nested tables: every key of the version that wrote them.

    Returns
    -------
    list of str
        One line for each key, sorted by key, with both values; empty if the same is measured. After
        `SHOWN` lines only the number of the others follows.
    """
    given_flat = flatten(given.model_dump(mode="json"))
    flat = {
        path: given_flat.get(path, value) if _is_hashed_out(path) else value
        for path, value in flatten(rename_old_keys(stored)).items()
        if HASHED_OUT.get(path[0]) is not True  # of a table without meaning here, half of each fits nowhere
    }
    foreign = _find_unknown_keys(nest_tables(flat))
    unknown = {path for path in flat if any(path[: len(key)] == key for key in foreign)}
    messages = {
        path: f"started with {json.dumps(flat[path])}; this version has no such key"
        for path in unknown
        if not _is_hashed_out(path)
    }
    try:
        known: Settings = _get_stored_settings_class()(
            **nest_tables({p: v for p, v in flat.items() if p not in unknown})
        )
        known = _fill_current_defaults(known)
        then = flatten(known.measured())
    except ValidationError as error:
        messages |= {
            _format_error_path(problem["loc"]): f"{problem['msg']} in this version"
            for problem in error.errors()
        }
    else:
        now = flatten(given.measured())
        # A key that is not hashed where it says what was done before it came has a value all the same.
        then_flat = flatten(known.model_dump(mode="json"))
        messages |= {
            path: f"started with {_format_json_value(then_flat | then, path)}, "
            f"is {_format_json_value(given_flat | now, path)} now"
            for path in {**then, **now}
            if _format_json_value(then, path) != _format_json_value(now, path)
        }
    # A position repeats what it takes from the tables above it.
    lines = [
        f"{'.'.join(path)} {text}"
        for path, text in sorted(messages.items())
        if path[:1] != ("positions",) or messages.get(path[2:]) != text
    ]
    return lines if len(lines) <= SHOWN else [*lines[:SHOWN], f"and {len(lines) - SHOWN} more"]


def _fill_current_defaults(settings: Settings) -> Settings:
    """Return the settings with the current defaults of plug-ins.

    They are returned unchanged if a plug-in is missing or rejects its parameters.
    """
    try:
        return fill_instrument_defaults(settings)
    except (ConfigurationError, ParametersError):
        return settings


def _find_unknown_keys(values: Tables) -> set[KeyPath]:
    """Return the paths of keys or tables that this version does not define; other errors are ignored."""
    try:
        _get_stored_settings_class()(**values)
    except ValidationError as error:
        kinds = {"extra_forbidden", "unexpected_keyword_argument"}
        return {_format_error_path(problem["loc"]) for problem in error.errors() if problem["type"] in kinds}
    return set()


def _is_hashed_out(path: KeyPath) -> bool:
    """Return whether a key, or a table that contains it, is excluded from the configuration hash.

    ``path`` is that of the key; `HASHED_OUT` lists what is excluded.
    """
    below: object = HASHED_OUT
    for name in path:
        if not isinstance(below, Mapping | set) or name not in below:
            return False
        below = below[name] if isinstance(below, Mapping) else True
        if below is True:
            return True
    return False


def _find_current_path(path: KeyPath) -> KeyPath | None:
    """Return the current path of a stored key (`RENAMED`): itself if not renamed, None if it was removed."""
    for old, new in RENAMED.items():
        names = old.split(".")
        if len(path) >= len(names) and all(a in ("*", b) for a, b in zip(names, path, strict=False)):
            any_names = iter([b for a, b in zip(names, path, strict=False) if a == "*"])
            if new is None:
                return None
            head = tuple(next(any_names) if name == "*" else name for name in new.split("."))
            return head + path[len(names) :]
    return path


def _format_error_path(location: tuple[int | str, ...]) -> KeyPath:
    """Convert the location of a validation error to a key path of texts."""
    return tuple(str(part) for part in location)


def _format_json_value(flat: Mapping[KeyPath, object], path: KeyPath) -> str:
    """Return the value at a path as JSON text, or ``no value`` if the path is absent."""
    return json.dumps(flat[path]) if path in flat else "no value"
