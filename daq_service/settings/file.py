"""Read the configuration: a TOML or JSON file, the environment on top, every refusal explained."""

from __future__ import annotations

import difflib
import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from daq_service.errors import UsageError
from daq_service.settings.instruments import ParametersError, fill_instrument_defaults
from daq_service.settings.schema import describe_key, list_known_keys
from daq_service.settings.stored import rename_old_keys
from daq_service.settings.tables import KeyPath, Tables, flatten, nest_tables
from daq_service.settings.tree import Settings
from daq_service.shared_file import read_shared
from hardware_drivers.errors import ConfigurationError

RECORDING = ("rig", "playback", "source")
FILES = (
    *("web.tls_certificate", "web.tls_key", "web.tokens_file"),
    *("notifications.receivers.*.url_file", "notifications.receivers.*.secret_file"),
)
"""Keys that name a file, relative to the configuration file."""
NOT_SETTINGS = ("SOLIMON_TEST_", "SOLIMON_DOUBLES", "SOLIMON_TOKEN")
"""Variables that are no keys: of the tests, where doubles of the vendor's libraries find
their brain, and what the client shows a service."""

PLACEHOLDER = "PLACEHOLDER"
"""Stands in a value that only the laboratory knows; what holds it is refused."""


def find_config_file(name: str) -> Path:
    """Return the path of a shipped file of ``config/``, in the installed package or an editable install.

    Raises UsageError if the installation lacks it.
    """
    package = Path(__file__).parents[1]
    for folder in (package / "config", package.parent / "config"):
        if (folder / name).is_file():
            return folder / name
    raise UsageError(f"{name} is missing from this installation of solimon; install it again")


def load_settings(path: Path | None, *, overrides: Mapping[str, object] | None = None) -> Settings:
    """Read and validate a TOML (or JSON) configuration; None reads the shipped ``simulated.toml``.

    Environment variables override ``overrides``, which override the file. Old keys are renamed in JSON only.

    Parameters
    ----------
    overrides
        Nested tables that replace values of the file, as command-line options do.

    Raises
    ------
    UsageError
        The file cannot be read or a value is rejected: file, key, value, bound and remedy.
    """
    path = find_config_file("simulated.toml") if path is None else path
    try:
        text = read_shared(path).decode()
        values = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except OSError as error:
        raise UsageError(f"cannot read the configuration {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 text: {error}; save it as UTF-8") from error
    except ValueError as error:
        raise UsageError(f"{path} is not valid {path.suffix.lstrip('.') or 'TOML'}: {error}") from error
    if not isinstance(values, dict):
        raise UsageError(f"{path} must hold tables, not a {type(values).__name__}")
    values.pop("$schema", None)
    # A JSON file is a folder's, maybe of an earlier version; a TOML file is a person's to correct.
    values = rename_old_keys(values) if path.suffix == ".json" else values
    return validate_settings(values, path, overrides=overrides)


def validate_settings(
    values: Tables, path: Path, *, overrides: Mapping[str, object] | None = None
) -> Settings:
    """Validate the tables of a file and return the settings with the defaults of their instruments.

    Relative file names count from the folder of ``path``; overrides replace values. Raises UsageError that
    lists every rejected key; also for placeholders (except in JSON) and for an unknown SOLIMON_ variable.
    """
    _reject_unknown_variables()
    if path.suffix != ".json":
        _reject_placeholders(values, path)
    values = _make_paths_absolute(values, path)
    try:
        return fill_instrument_defaults(Settings(**_merge_tables(values, overrides or {})))
    except ValidationError as error:
        raise UsageError(_explain_rejections(error.errors(), list_known_keys(), path)) from error
    except ParametersError as error:
        raise UsageError(_explain_rejections(error.problems, error.keys, path)) from error
    except ConfigurationError as error:
        raise UsageError(_format_rejection(path, [str(error)])) from error


def find_placeholders(values: Mapping[str, object]) -> list[KeyPath]:
    """Return the paths of keys whose value contains `PLACEHOLDER` and is not set by the environment."""
    return [
        key
        for key, value in flatten(values).items()
        if PLACEHOLDER in str(value) and f"SOLIMON_{'__'.join(key)}".upper() not in map(str.upper, os.environ)
    ]


def _reject_placeholders(values: Mapping[str, object], path: Path) -> None:
    """Raise UsageError that lists every key whose value is still a placeholder, with its description."""
    if missing := find_placeholders(values):
        lines = "\n".join(f"  {'.'.join(key)}: {describe_key(key)}" for key in missing)
        raise UsageError(
            f"{path} is not finished; still {PLACEHOLDER}:\n{lines}\n"
            f"Fill them in and run `solimon check-config {path}`."
        )


def _make_paths_absolute(values: Tables, path: Path) -> Tables:
    """Return the tables with file names (`FILES`, `RECORDING`) made absolute from the folder of ``path``."""
    flat, folder = flatten(values), path.absolute().parent
    for key, value in flat.items():
        named = any(fnmatchcase(".".join(key), name) for name in FILES)
        if isinstance(value, str) and (key == RECORDING or (named and value)):
            flat[key] = str(folder / value)
    return nest_tables(flat)


def _reject_unknown_variables() -> None:
    """Raise UsageError for the first SOLIMON_ variable that names no table; its keys are validated later."""
    tables = {f"SOLIMON_{name.upper()}" for name in Settings.model_fields}
    for name in sorted(os.environ):
        if name.startswith("SOLIMON_") and not name.startswith(NOT_SETTINGS):
            table = name.upper().partition("__")[0]
            if table not in tables:
                near = difflib.get_close_matches(table, tables, n=1, cutoff=0.6)
                hint = f"did you mean {near[0]}?" if near else "unset it"
                raise UsageError(
                    f"the environment variable {name} names no table of the configuration; {hint}"
                )


def _merge_tables(values: Mapping[str, object], overrides: Mapping[str, object]) -> Tables:
    """Return a copy of nested tables in which overrides replace values; tables are merged key by key."""
    merged = dict(values)
    for key, value in overrides.items():
        below = merged.get(key)
        merged[key] = (
            _merge_tables(below, value) if isinstance(below, dict) and isinstance(value, Mapping) else value
        )
    return merged


def _explain_rejections(problems: Sequence[Mapping[str, Any]], keys: Sequence[str], path: Path) -> str:
    """Format a message with one line for each rejected value: key, reason, value or similar known key.

    ``keys`` are the known names. Values of notification receivers are omitted (possible secrets), and so are
    errors that a position inherits from a top-level table.
    """
    refused = {problem["loc"] for problem in problems}
    lines = []
    for problem in problems:
        if problem["loc"][:1] == ("positions",) and problem["loc"][2:] in refused:
            continue  # inherited from a top-level table that is refused itself
        where = [str(part) for part in problem["loc"]]
        key = ".".join(where) or "(whole file)"
        if problem["type"] in {"extra_forbidden", "unexpected_keyword_argument"}:
            near = difflib.get_close_matches(where[-1], keys, n=1, cutoff=0.6)
            hint = f"; did you mean {near[0]}?" if near else "; remove it"
            lines.append(f"{key}: unknown key{hint}")
        else:
            value = problem.get("input")
            # Of a receiver nothing is repeated: a secret may have been written where its place belongs.
            may_show = problem["loc"][:2] != ("notifications", "receivers")
            shown = f" (value: {value!r})" if may_show and isinstance(value, (str, int, float, bool)) else ""
            lines.append(f"{key}: {problem['msg'].removeprefix('Value error, ')}{shown}")
    return _format_rejection(path, lines)


def _format_rejection(path: Path, lines: Sequence[str]) -> str:
    """Format the error message of an invalid configuration: file, distinct problem lines, next command."""
    shown_lines = "\n".join(f"  {line}" for line in dict.fromkeys(lines))
    return (
        f"{path} (with SOLIMON_... from the environment) is refused:\n{shown_lines}\n"
        f"Correct it and run `solimon check-config {path}`."
    )
