"""The attributes (NI calls them properties) that the variadic entries read and write.

A number names the attribute and with it the C type of its value; the same table shows the C library
what to take from the variable arguments. Booleans are 32-bit numbers as in C.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from simulator.doubles.vendor_api.entry_points import Parameter, Role


@dataclass(frozen=True, slots=True)
class Attribute:
    """Attribute of a vendor API.

    Attributes
    ----------
    family
        Which pair of entries it belongs to: ``DAQmxGet<family>Attribute``.
    c_type
        Type of its value or of an array's elements; ``char`` for text.
    is_array
        The value is an array of numbers.
    settable
        False: reading only.
    """

    number: int
    name: str
    family: str
    c_type: str
    is_array: bool
    settable: bool

    def value(self, number: Role, array: Role, text: Role) -> Parameter:
        """Return the parameter ``value`` of the attribute, in the role of the three that fits its type."""
        role = text if self.c_type == "char" else array if self.is_array else number
        return Parameter("value", role, self.c_type)


def _read_attribute_table() -> Iterator[Attribute]:
    """Read ``attributes.csv`` next to this module and yield its attributes in the order of the rows."""
    lines = Path(__file__).with_name("attributes.csv").read_text(encoding="utf-8").splitlines()
    for row in csv.DictReader(lines):
        c_type = row["c_type"].removesuffix("[]")
        yield Attribute(
            number=int(row["number"], 16),
            name=row["name"],
            family=row["family"],
            c_type=c_type,
            is_array=row["c_type"].endswith("[]") and c_type != "char",
            settable=row["settable"] == "yes",
        )


ATTRIBUTES: Mapping[int, Attribute] = {attribute.number: attribute for attribute in _read_attribute_table()}
"""By number."""
