"""Find the keys of the configuration that a sweep may change, and set their values.

The keys are found in the parameter dataclasses themselves, so that a new parameter can be swept at once.
"""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from daq_service.errors import UsageError
from daq_service.shared_file import load_module_toml
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters

SECTIONS: Mapping[str, type] = {
    "chain": ChainParameters,
    "plate": PlateParameters,
    "corrosion": CorrosionParameters,
}

ZENER_KEYS = TypeAdapter(dict[str, tuple[str, ...]]).validate_python(load_module_toml(__file__))["zener"]
"""What counts in Zener's model; the other keys do not change its numbers."""


@cache
def list_known_keys() -> tuple[str, ...]:
    """Return all keys of chain, plate and corrosion as in the configuration, tables included."""
    return tuple(key for name, section in SECTIONS.items() for key in _yield_keys(section, name))


def _yield_keys(section: type, above: str) -> Iterator[str]:
    """Yield the dotted keys of a section and, recursively, of the tables below it.

    ``above`` is the key of the section itself.
    """
    hints = get_type_hints(section)
    for field in fields(section):
        key = f"{above}.{field.name}"
        below = _list_dataclasses(hints[field.name])
        yield key
        for table in below:
            yield from _yield_keys(table, key)


def _list_dataclasses(hint: object) -> list[type]:
    """Return the dataclasses that a value of this type may be: tables in the configuration.

    Empty for a plain value.
    """
    if get_origin(hint) is Annotated:
        return _list_dataclasses(get_args(hint)[0])
    if get_origin(hint) in (Union, types.UnionType):
        return [table for option in get_args(hint) for table in _list_dataclasses(option)]
    return [hint] if isinstance(hint, type) and is_dataclass(hint) else []


def check_sweep_key(key: str, model: str) -> None:
    """Raise an error for a key that does not exist or has no effect in `model`.

    Raises
    ------
    UsageError
        With the key that was probably meant and the list of all.
    """
    known = ZENER_KEYS if model == "zener" else list_known_keys()
    if key in known:
        return
    if key in list_known_keys():
        raise UsageError(f"{key} has no influence on --model zener; what counts there: {', '.join(known)}")
    same_name = [name for name in known if name.rpartition(".")[2] == key.rpartition(".")[2]]
    near = same_name or difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    hint = f"did you mean {' or '.join(dict.fromkeys(near))}? " if near else ""
    raise UsageError(f"{key!r} is no key that can be swept; {hint}All keys: {', '.join(known)}")


def replace_section_values(section: Any, changes: Mapping[tuple[str, ...], object]) -> Any:
    """Copy a section with changed values, validated like a configuration file.

    Parameters
    ----------
    section
        A dataclass of `SECTIONS`.
    changes
        Path below the section, for example ``("drop_height_m",)``, and its value.

    Raises
    ------
    ValueError
        A value has the wrong type or breaks a bound, with its key.
    """
    content = asdict(section)
    for path, value in changes.items():
        table = content
        for name in path[:-1]:
            if not isinstance(table.get(name), dict):
                table[name] = {}
            table = table[name]
        table[path[-1]] = value
    try:
        section_changed = _ADAPTERS[type(section)].validate_python(content)
    except ValidationError as error:
        raise ValueError(_describe_validation_error(error)) from error
    for path, value in changes.items():
        # pydantic accepts true for 1.0, which is never intended.
        if isinstance(value, bool) and not isinstance(read_value_at(section_changed, path), bool):
            raise ValueError(f"{'.'.join(path)} is {str(value).lower()}; it must be a number or a name")
    return section_changed


def read_value_at(section: object, path: tuple[str, ...]) -> object:
    """Return the value at a path of attribute names below a section; AttributeError if there is none."""
    for name in path:
        section = getattr(section, name)
    return section


_ADAPTERS: Mapping[type, TypeAdapter[Any]] = {section: TypeAdapter(section) for section in SECTIONS.values()}


def _describe_validation_error(error: ValidationError) -> str:
    """Format the messages of a validation error in one line, each with its key and value."""
    problems = []
    for problem in error.errors():
        where = ".".join(str(part) for part in problem["loc"])
        message = problem["msg"].removeprefix("Value error, ")
        value = problem.get("input")
        shown = f" (value: {value!r})" if where and isinstance(value, (str, int, float)) else ""
        problems.append(f"{where + ': ' if where else ''}{message}{shown}")
    return "; ".join(problems)
