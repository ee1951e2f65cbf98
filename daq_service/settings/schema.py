"""What each key of the configuration is: its JSON Schema, and its description in words."""

from __future__ import annotations

import ast
import inspect
import logging
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from types import ModuleType

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import DataclassSchema, ModelSchema

from daq_service.settings.tree import Settings
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.plug_ins import find_offers

log = logging.getLogger(__name__)


@cache
def _parse_classes(module: ModuleType | None) -> dict[str, ast.ClassDef]:
    """Parse a module's source and return its top-level class definitions by name; empty for None. Cached.

    Raises OSError if the source is not available.
    """
    tree = ast.parse(inspect.getsource(module)) if module else ast.Module([], [])
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def _read_attribute_docstrings(kind: type) -> dict[str, str]:
    """Read the text below each annotated attribute of a class from its source, by attribute.

    Attributes without a text are left out. Raises KeyError if the class is not at the top level of its
    module.
    """
    texts = {}
    for attribute, text in pairwise(_parse_classes(inspect.getmodule(kind))[kind.__name__].body):
        match attribute, text:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                texts[name] = inspect.cleandoc(words)
    return texts


class _Described(GenerateJsonSchema):
    """Describes each key by the text below its attribute.

    pydantic's ``use_attribute_docstrings`` would read the sources anew at each start of each process.
    """

    def _add_key_descriptions(self, table: JsonSchemaValue, kind: type) -> JsonSchemaValue:
        """Add to the schema of a class, in place, the attribute texts of the class and its bases; return it.

        Existing descriptions stay; the text of the most derived class is used.
        """
        keys = table["properties"]
        for base in kind.__mro__[:-1]:
            if base.__name__ not in _parse_classes(inspect.getmodule(base)):
                continue  # pydantic's own, or made by a function
            for name, words in _read_attribute_docstrings(base).items():
                keys.get(name, {}).setdefault("description", words)
        return table

    def model_schema(self, schema: ModelSchema) -> JsonSchemaValue:
        """Return the JSON Schema of a pydantic model, with its attribute texts as descriptions."""
        return self._add_key_descriptions(super().model_schema(schema), schema["cls"])

    def dataclass_schema(self, schema: DataclassSchema) -> JsonSchemaValue:
        """Return the JSON Schema of a dataclass, with its attribute texts as descriptions."""
        return self._add_key_descriptions(super().dataclass_schema(schema), schema["cls"])


def build_settings_schema() -> JsonSchemaValue:
    """Build the JSON Schema of the configuration, as shipped in ``config/settings.schema.json``."""
    schema = Settings.model_json_schema(schema_generator=_Described)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def build_schema_with_kinds() -> JsonSchemaValue:
    """Build the JSON Schema with the keys of every installed kind of instrument.

    A kind that cannot be imported is logged and left out; it is rejected where a configuration names it.
    """
    schema = build_settings_schema()
    choices = []
    for name, offer in find_offers().items():
        try:
            kind = offer.load()
        except ConfigurationError as error:
            log.warning("%s", error)
            continue
        keys = TypeAdapter(kind.parameters).json_schema(
            schema_generator=_Described, ref_template=f"#/$defs/{name}.{{model}}"
        )
        schema["$defs"] |= {f"{name}.{below}": table for below, table in keys.pop("$defs", {}).items()}
        keys["properties"] = {"kind": {"const": name}, **keys.get("properties", {})}
        choices.append({"if": {"properties": {"kind": {"const": name}}}, "then": keys})
    schema["$defs"]["InstrumentSettings"]["allOf"] = choices
    return schema


def describe_key(path: Sequence[str]) -> str:
    """Return the description of a key or table in one line; empty if the key is unknown or has none.

    The text below the attribute is used, else the first paragraph of its class.
    """
    schema = _get_cached_schema()
    node = schema
    for name in path:
        node = _resolve_reference(schema, node)
        below = node.get("properties", {}).get(name, node.get("additionalProperties"))
        node = below if isinstance(below, dict) else {}
    words = node.get("description") or _resolve_reference(schema, node).get("description", "")
    return " ".join(words.partition("\n\n")[0].split())


_get_cached_schema = cache(build_settings_schema)
"""Builds the JSON Schema of the settings on the first call and returns the same object later."""


def _resolve_reference(schema: JsonSchemaValue, node: JsonSchemaValue) -> JsonSchemaValue:
    """Return the definition that a schema node refers to, also as one of ``anyOf``; else the node itself."""
    options = [node, *node.get("anyOf", [])]
    names = [option["$ref"].rpartition("/")[2] for option in options if "$ref" in option]
    return schema["$defs"][names[0]] if names else node


def list_known_keys() -> list[str]:
    """Return the distinct names of all keys and tables at any level, sorted."""
    tables = (_get_cached_schema(), *_get_cached_schema()["$defs"].values())
    return sorted({name for table in tables for name in table.get("properties", {})})
