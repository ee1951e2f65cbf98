"""``solimon init``: write a commented configuration and its JSON Schema for the editor."""

from __future__ import annotations

import difflib
import json
import tomllib
from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import tomlkit
from tomlkit.exceptions import TOMLKitError

from daq_service.errors import UsageError
from daq_service.processes.printing import print_result
from daq_service.settings.commented import format_commented_toml, uncomment_tables
from daq_service.settings.file import find_config_file, find_placeholders, validate_settings
from daq_service.settings.schema import build_settings_schema
from daq_service.settings.tables import KeyPath, Tables, flatten, nest_tables
from daq_service.settings.tree import Settings

SCHEMA = "settings.schema.json"


def write_configuration(
    *,
    kind: str,
    file: Path,
    source: Path | None,
    assignments: Sequence[str],
    switch_on: Sequence[str],
    switch_off: Sequence[str],
    as_json: bool,
) -> None:
    """Run `solimon init`: write a configuration file and its schema, and print what is left to fill in.

    ``kind`` is "rig", "twin" or, with ``source``, "playback". Existing files are never overwritten.
    Placeholders are not validated.

    Raises
    ------
    UsageError
        An option, key, table or value is invalid, or a file exists or cannot be written.
    """
    if (source is not None) != (kind == "playback"):
        raise UsageError("--source names the recording of `init playback`, and belongs to it alone")
    off: set[KeyPath] = set()
    values: Tables = tomllib.loads(find_config_file("simulated.toml").read_text(encoding="utf-8"))
    found: list[str] = []
    if kind == "rig":
        values, off = read_lab_config()
    elif source is not None:
        from daq_service.cli.set_up.recording import build_playback_values

        values, found = build_playback_values(source, values)
    for name in switch_on:
        off -= {table for table in off if _is_in_tables(table, [_find_table(values, name)])}
    off |= {_find_table(values, name) for name in switch_off}
    values = _assign_values(values, assignments)
    missing = find_placeholders(_remove_tables(values, off))
    if not missing:
        validate_new_file(values, off, file)
    schema = refuse_to_overwrite(file)
    write_config(file, values, head=_read_head_comment(kind), off=off)
    keys = [".".join(key) for key in missing]
    result = {"kind": kind, "file": str(file), "schema": str(schema), "placeholders": keys}
    fill_in = [f"to fill in: {key}" for key in keys]
    lines = [*found, f"{file} is written with its schema", *fill_in, f"next: solimon check-config {file}"]
    print_result(result, lines, as_json=as_json)


def format_schema() -> str:
    """Return the JSON Schema of the configuration as text, as in ``config/settings.schema.json``."""
    return json.dumps(build_settings_schema(), indent=1) + "\n"


# What is written -------------------------------------------------------------------------------------


def read_lab_config() -> tuple[Tables, set[KeyPath]]:
    """Read all values of the shipped laboratory.toml, and the paths of the tables that it switches off."""
    text = find_config_file("laboratory.toml").read_text(encoding="utf-8")
    values, active = tomllib.loads(uncomment_tables(text)), flatten(tomllib.loads(text))
    tables = {key[:depth] for key in flatten(values) for depth in range(1, len(key))}
    return values, {table for table in tables if not any(_is_in_tables(key, [table]) for key in active)}


def _assign_values(values: Tables, assignments: Sequence[str]) -> Tables:
    """Return the values with those of each ``KEY=VALUE`` replaced; ``*`` in a key matches any text.

    Raises UsageError if no key matches or a value is not valid TOML.
    """
    keys = {".".join(path): path for path in flatten(values)}
    filled = flatten(values)
    for assignment in assignments:
        pattern, equals, text = assignment.partition("=")
        matching = [path for name, path in keys.items() if fnmatchcase(name, pattern.strip())]
        if not equals or not matching:
            raise _create_name_error(pattern, keys, "--set KEY=VALUE")
        for path in matching:
            filled[path] = _parse_value_like(text.strip(), like=filled[path])
    return nest_tables(filled)


def _parse_value_like(text: str, *, like: object) -> object:
    """Return the text if ``like`` is a string, otherwise parse it as TOML; raise UsageError if invalid."""
    if isinstance(like, str):
        return text
    try:
        return tomlkit.value(text).unwrap()
    except TOMLKitError as error:
        raise UsageError(f"--set: {text} is not a TOML value: {error}; write one like {like}") from error


def _find_table(values: Tables, name: str) -> KeyPath:
    """Return the path of a table from its dotted name; raise UsageError, with a near name, if none."""
    tables = {".".join(key[:depth]): key[:depth] for key in flatten(values) for depth in range(1, len(key))}
    if name not in tables:
        raise _create_name_error(name, tables, "--with or --without TABLE")
    return tables[name]


def _create_name_error(name: str, known: Collection[str], option: str) -> UsageError:
    """Create the UsageError for an unknown name of an option, with the nearest known one."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return UsageError(f"{option}: there is no {name!r} here" + (f"; did you mean {near[0]}?" if near else ""))


def _remove_tables(values: Tables, off: Collection[KeyPath]) -> Tables:
    """Return the values without the tables that are switched off."""
    return nest_tables({key: value for key, value in flatten(values).items() if not _is_in_tables(key, off)})


def _is_in_tables(key: KeyPath, tables: Collection[KeyPath]) -> bool:
    """Return whether a key is one of these tables or within one."""
    return any(key[: len(table)] == table for table in tables)


# Files -----------------------------------------------------------------------------------------------


def _read_head_comment(name: str) -> str:
    """Read the comment at the top of a configuration file: of a kind of `solimon init`, or "setup"."""
    return (Path(__file__).parent / "heads" / f"{name}.txt").read_text(encoding="utf-8").rstrip()


def format_head_comment(instruments: Collection[str], struck: Collection[str]) -> str:
    """Format the comment at the top of a file of `solimon setup`: instruments, and positions struck."""
    sentence = (
        f"From strikes of {', '.join(struck)}."
        if struck
        else "Nothing was struck: range, level and holdoff are a guess."
    )
    return _read_head_comment("setup").format(instruments=", ".join(sorted(instruments)), struck=sentence)


def refuse_to_overwrite(file: Path) -> Path:
    """Return the path of the new file's schema; raise UsageError if a file would be overwritten.

    Also raised if the name does not end in ``.toml``. An equal schema may exist.
    """
    if file.suffix != ".toml":
        raise UsageError(f"{file} will hold TOML: let its name end in .toml")
    schema = file.absolute().parent / SCHEMA
    if file.exists():
        raise UsageError(f"{file} is there already and is not written over; choose another name")
    if schema.exists() and schema.read_text(encoding="utf-8", errors="replace") != format_schema():
        raise UsageError(
            f"{schema} is there already and is another one, maybe of another version of solimon; move it "
            "away, or write into another folder"
        )
    return schema


def validate_new_file(values: Tables, off: Collection[KeyPath], file: Path) -> Settings:
    """Return the settings of the values of a new file, without the tables ``off``.

    Raises UsageError as for a file that is read; nothing is written.
    """
    return validate_settings(_remove_tables(values, off), file.absolute())


def write_config(file: Path, values: Tables, *, head: str, off: Collection[KeyPath]) -> None:
    """Write a commented configuration, and its schema into the same folder.

    ``head`` is the comment at the top; tables in ``off`` are written as comments. Raises UsageError if a file
    exists or cannot be written; the schema may then remain.
    """
    schema, text = refuse_to_overwrite(file), format_commented_toml(values, head=head, switched_off=off)
    try:
        schema.write_text(format_schema(), encoding="utf-8", newline="\n")
        file.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}; choose another place") from error
