"""Packages that solimon installs, who needs them, and their licences by what each says of itself.

``python -m support.licences`` in ``tests/`` prints the table of docs/reference/licences.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import Distribution, distributions, metadata

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

BROUGHT_BY_PYTHON = {"pip", "setuptools"}
OURS = "solimon"
EXTRAS = (
    "twin",
    "report",
    "demo",
    "grpc",
    "niscope",
    "tdms",
    "parquet",
    "client",
    "notify",
    "visa",
    "conformance",
    "docs",
    "test",
    "dev",
    "cluster",
)
_LONGEST = 60

Need = tuple[str, Requirement]
"""A package, and what it needs."""


@cache
def installed() -> dict[str, Distribution]:
    """Return every installed package by its normalized name, without those of Python."""
    found = {canonicalize_name(one.metadata["Name"]): one for one in distributions()}
    return {name: one for name, one in sorted(found.items()) if name not in BROUGHT_BY_PYTHON}


@cache
def _wanted(name: str) -> tuple[Requirement, ...]:
    """Return the requirements of an installed package for all systems and extras, parsed once."""
    return tuple(map(Requirement, installed()[name].requires or []))


def needs(extra: str, system: Mapping[str, str]) -> Iterator[Need]:
    """Yield the requirements of solimon with an extra ("": without any) on a system, as far as installed."""
    here, left, seen = installed(), [(OURS, extra), (OURS, "")], set[tuple[str, str]]()
    while left:
        name, its_extra = left.pop()
        if (name, its_extra) in seen or name not in here:
            continue
        seen.add((name, its_extra))
        for wanted in _wanted(name):
            if wanted.marker is None or wanted.marker.evaluate({**system, "extra": its_extra}):
                yield name, wanted
                left += [(canonicalize_name(wanted.name), also) for also in ("", *wanted.extras)]


def licence_of(package: Distribution) -> str:
    """Return the SPDX expression, else classifiers, else the first line of the text, else its file."""
    fields = metadata(package.metadata["Name"])
    if expression := fields["License-Expression"]:
        return str(expression)
    classified = [text for text in fields.get_all("Classifier") or [] if text.startswith("License :: OSI")]
    if classified:
        return "; ".join(sorted(text.rpartition(" :: ")[2] for text in classified))
    first_line = str(fields["License"] or "").strip().partition("\n")[0][:_LONGEST]
    return first_line or f"in its {', '.join(fields.get_all('License-File') or [])}"


def brought() -> dict[str, str]:
    """Return each installed package that solimon needs, with the extra that requires it ("": none)."""
    found: dict[str, str] = {}
    for extra in ("", *EXTRAS):
        for _, wanted in needs(extra, {}):
            found.setdefault(canonicalize_name(wanted.name), extra)
    return {name: found[name] for name in installed() if name in found and name != OURS}


def rows() -> dict[str, str]:
    """Return the rows of the table by package name."""
    here = installed()
    return {
        name: f"| {name} | {licence_of(here[name])} | {f'`{extra}`' if extra else 'solimon'} |"
        for name, extra in brought().items()
    }


if __name__ == "__main__":
    print("\n".join(rows().values()))
