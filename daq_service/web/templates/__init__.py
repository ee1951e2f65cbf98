"""Templates of the printable HTML pages, and the texts of their numbers.

A page is one file without scripts: `base.html.j2` has head and style, `macros.html.j2` tables and figures.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from daq_service.alarms.states import format_probability
from daq_service.clock import format_utc

NOT_KNOWN = "not available"


def render_template(template: str, **context: object) -> bytes:
    """Render a template to the HTML of a page, or to a text, in UTF-8.

    Raises
    ------
    jinja2.UndefinedError
        The template uses a name that the context does not have.
    jinja2.TemplateNotFound
        There is no such template.
    """
    return _create_environment().get_template(template).render(context).encode()


@cache
def _create_environment() -> Environment:
    """Create the Jinja environment of the templates with its filters; it escapes HTML. Cached."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=lambda name: not (name or "").endswith(".txt.j2"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "base64": lambda content: base64.b64encode(content).decode(),
        "plain": format_plain_text,
        "quantity": format_quantity,
        "significant": format_significant,
        "percent": format_probability,
        "utc": lambda utc_ns: f"{format_utc(utc_ns, 0)[:16].replace('T', ' ')} UTC",
        "words": lambda name: name.replace("_", " "),
    }
    environment.globals |= {"not_known": NOT_KNOWN, "solimon": f"solimon {version('solimon')}"}
    return environment


def format_quantity(value: float | None, factor: float = 1.0, digits: int = 2, unit: str = "") -> str:
    """Format a value times ``factor`` with ``digits`` decimals and ``unit``; `NOT_KNOWN` for None."""
    if value is None:
        return NOT_KNOWN
    return f"{value * factor:.{digits}f} {unit}".rstrip()


def format_significant(value: float | None, digits: int = 4) -> str:
    """Format a number with ``digits`` significant digits; `NOT_KNOWN` for None."""
    return NOT_KNOWN if value is None else f"{value:.{digits}g}"


def format_plain_text(value: object) -> str:
    """Format any value of a row as text: items of collections joined by commas, None as `NOT_KNOWN`.

    A float has four significant digits. Missing values of a mapping are left out.
    """
    if isinstance(value, Mapping):
        known = {name: item for name, item in value.items() if item is not None}
        return ", ".join(f"{name} {format_plain_text(item)}" for name, item in known.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(format_plain_text, value))
    return format_significant(value) if isinstance(value, float) or value is None else str(value)
