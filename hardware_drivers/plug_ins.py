"""Installed kinds of instruments, found by their entry points; solimon's own included.

Finding reads the metadata of installed distributions; only a kind that is asked for is imported.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.kinds import GROUPS, ROLES, Kind, Role

OURS = "solimon"


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """Kind as offered by distributions, not imported yet.

    Attributes
    ----------
    by_role
        Its entry point for each role, as one distribution gives it.
    distributions
        Names and versions of those that offer a kind of this name: one, or it is refused.
    """

    name: str
    by_role: Mapping[Role, EntryPoint]
    distributions: tuple[str, ...]

    @property
    def roles(self) -> tuple[Role, ...]:
        """Return the roles that the kind can take in a rig, in the order of `ROLES`."""
        return tuple(self.by_role)

    def load(self) -> Kind[Any]:
        """Import the kind from the entry points of all its roles and return it.

        Raises
        ------
        ConfigurationError
            Two distributions offer it, one offers different objects for its roles, its module does not
            import, or what it names is no kind.
        """
        if len(self.distributions) > 1:
            raise ConfigurationError(
                f"the kind {self.name!r} is offered by {' and by '.join(self.distributions)}; uninstall one"
            )
        kinds = {id(kind): kind for kind in map(self._import_kind, self.by_role.values())}
        if len(kinds) > 1:
            raise ConfigurationError(
                f"{self.distributions[0]} offers different objects as {self.name!r} for the roles "
                f"{', '.join(self.roles)}; one kind is one object: report it to its maintainer"
            )
        return next(iter(kinds.values()))

    def _import_kind(self, entry_point: EntryPoint) -> Kind[Any]:
        """Import the kind that an entry point names, and return it.

        Raise ConfigurationError for any exception of the import, SystemExit included, or if it is no `Kind`.
        """
        offered = f"{self.distributions[0]} offers {entry_point.value} as the kind {self.name!r}"
        try:
            kind = entry_point.load()
        except (Exception, SystemExit) as error:
            raise ConfigurationError(
                f"{offered}, which cannot be imported ({type(error).__name__}: {error}); install that "
                "package again, or report it to its maintainer"
            ) from error
        if not isinstance(kind, Kind):
            raise ConfigurationError(
                f"{offered}, which is a {type(kind).__name__}, not a hardware_drivers.kinds.Kind; report it "
                "to its maintainer"
            )
        return kind


def find_offers() -> Mapping[str, Offer]:
    """Find the installed kinds, by name in alphabetical order; none of them is imported.

    Cached: installed packages are searched again only if `sys.path` has changed.
    """
    return _read_offers(tuple(sys.path))


@lru_cache(maxsize=1)
def _read_offers(path: tuple[str, ...]) -> Mapping[str, Offer]:
    """Read the kinds that the installed distributions offer, by name in alphabetical order.

    Cached for one search path: installed packages stay while a process runs. A kind of several
    distributions has the entry points of the first one.
    """
    found: dict[str, dict[str, dict[Role, EntryPoint]]] = {}
    every = entry_points()
    for role in ROLES:
        for entry_point in every.select(group=GROUPS[role]):
            given = found.setdefault(entry_point.name, {}).setdefault(_format_distribution(entry_point), {})
            given[role] = entry_point
    return {
        name: Offer(name=name, by_role=next(iter(given.values())), distributions=tuple(sorted(given)))
        for name, given in sorted(found.items())
    }


def find_kind(name: str) -> tuple[Kind[Any], Offer]:
    """Find the installed kind of a name, import it, and return it with its offer.

    Raises
    ------
    ConfigurationError
        No installed package offers it; the message lists the names. Or as `Offer.load`.
    """
    known = find_offers()
    if name not in known:
        raise ConfigurationError(
            f"no installed package offers the kind {name!r}; there are: "
            f"{_format_kind_names(known.values())}; install the package that offers it next to solimon "
            "(python -m pip install PACKAGE), or correct the name"
        )
    return known[name].load(), known[name]


def _format_kind_names(known: Iterable[Offer]) -> str:
    """Format the names of kinds as one text with commas; those of other packages with package and version.

    Without any kind, return a text that asks to install solimon again.
    """
    names = []
    for offer in known:
        package = offer.distributions[0]
        names.append(offer.name if package.startswith(f"{OURS} ") else f"{offer.name} ({package})")
    return ", ".join(names) or f"none, not even those of {OURS} itself: install {OURS} again"


def _format_distribution(entry_point: EntryPoint) -> str:
    """Return name and version of an entry point's distribution; ``an unknown package`` without metadata."""
    found = entry_point.dist
    return "an unknown package" if found is None else f"{found.name} {found.version}"
