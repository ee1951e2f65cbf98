"""Write the acceptance report as one self-contained, printable HTML page."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from html import escape
from itertools import groupby

from daq_service.cli.maintenance.acceptance.contents import AcceptanceReport
from daq_service.cli.maintenance.acceptance.criteria import Comparison
from daq_service.cli.maintenance.acceptance.quantity import Quantity, Series, Table

_STYLE = """
:root { --ink: #14181c; --soft: #55606a; --line: #d8dde2; --good: #00664a; --bad: #a33b00; --open: #6a5300 }
* { box-sizing: border-box }
body { font: 14px/1.45 system-ui, sans-serif; color: var(--ink); max-width: 64rem; margin: 2rem auto;
       padding: 0 1.2rem }
header { border-bottom: 3px solid var(--ink); padding-bottom: .8rem }
h1 { font-size: 1.5rem; margin: 0 } h2 { font-size: 1.1rem; margin: 2rem 0 .4rem }
h3 { font-size: .95rem; margin: 1.2rem 0 .2rem }
.outcome { display: flex; gap: 1rem; align-items: baseline; margin: 1rem 0; padding: .7rem 1rem;
           border: 2px solid; border-radius: 6px }
.outcome b { font-size: 1.5rem; letter-spacing: .04em; text-transform: uppercase }
.pass { color: var(--good) } .fail { color: var(--bad) } .undecided, .incomplete { color: var(--open) }
.aside, .note { color: var(--soft) } .note { font-size: .88rem }
table { border-collapse: collapse; width: 100%; font-size: .88rem }
th, td { text-align: left; vertical-align: top; padding: .22rem .6rem .22rem 0;
         border-bottom: 1px solid var(--line) }
thead th { border-bottom: 2px solid var(--ink) } tbody th { font-weight: normal }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
td > span.pass, td > span.fail, td > span.undecided { font-weight: 600 }
td > span { white-space: nowrap } td > span.aside { white-space: normal }
#identity td { overflow-wrap: anywhere }
#identity td:first-child { width: 9rem; color: var(--soft) }
.pictures { display: grid; grid-template-columns: 1fr 1fr; gap: .6rem 1.4rem }
figure { margin: 0 } img { width: 100%; height: auto; display: block }
figcaption { font-size: .85rem } figcaption .note { display: block }
@media (max-width: 44rem) { .pictures { grid-template-columns: 1fr } }
@media print { body { margin: 0; max-width: none; font-size: 11px } h2 { break-after: avoid }
  tr, figure { break-inside: avoid } .pass, .fail, .undecided, .incomplete { color: inherit } }
"""
_WORDS = {
    "pass": "every criterion that applies is kept",
    "fail": "at least one criterion is not kept",
    "incomplete": "none is broken, but not every criterion can be decided",
}
_MARKS = {"pass": "✓", "fail": "✗", "undecided": "?", "does not apply": "·", "left out": "·"}
SCALES = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


def page(report: AcceptanceReport, pictures: Mapping[str, bytes]) -> bytes:
    """Return the HTML of the report.

    Parameters
    ----------
    pictures
        PNG of each series that has values, by its name.
    """
    title = f"Acceptance report of the test {report.identity['test']}"
    quantities = groupby(report.quantities, key=lambda item: item.section)
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<header><h1>{escape(title)}</h1>",
        f"<p class='note'>Made at {report.made_utc} by {escape(report.made_by)}</p></header>",
        (
            f"<p class='outcome {report.outcome}'><b>{report.outcome}</b>"
            f"<span>{_WORDS[report.outcome]}</span></p>"
        ),
        *(f"<p class='note'>{escape(note)}</p>" for note in report.notes),
        "<section id='criteria'><h2>Criteria</h2>",
        _table(
            ("", "criterion", "limit", "value", "because"),
            (_criterion_row(item) for item in report.comparisons),
            numbers=(2, 3),
        ),
        "</section><section id='identity'><h2>What was tested</h2>",
        _table((), ((_cell(name), _cell(value)) for name, value in report.identity.items())),
        "</section><section id='pictures'><h2>Over the hours of the test</h2>",
        "<p class='note'>Gaps are shaded.</p><div class='pictures'>",
        *(_figure(item, pictures.get(item.name)) for item in report.series),
        "</div></section><section id='numbers'><h2>Numbers</h2>",
        *(_section(name, quantities_of_section) for name, quantities_of_section in quantities),
        "</section><section id='events'><h2>What happened</h2>",
        *(_happened(table) for table in report.tables),
        "</section></body></html>\n",
    ]
    return "\n".join(parts).encode()


def shown(unit: str, *values: float | int | None) -> str:
    """Format numbers with their unit: the first one, then the interval of the others.

    Four figures; bytes in the largest unit that fits the first.
    """
    value, *ends = values
    if value is None:
        return "not known"
    scale, scaled = 1.0, unit
    if unit.startswith("B"):
        scale, name = next(((s, name) for s, name in SCALES if abs(value) >= s), (1.0, "B"))
        scaled = f"{name}{unit[1:]}"
    numbers = [
        f"{item:,}" if isinstance(item, int) and scale == 1.0 else f"{item / scale:.4g}"
        for item in values
        if item is not None
    ]
    text = f"{numbers[0]} ({' to '.join(numbers[1:])})" if len(numbers) == 1 + len(ends) > 1 else numbers[0]
    return text if unit == "1" else f"{text} {scaled.removeprefix('1 ')}"


def interval(item: Quantity) -> str:
    """Format a quantity with its interval, if it has one."""
    return shown(item.unit, item.value, item.low, item.high)


def asked(item: Comparison) -> str:
    """Format a criterion's limit; empty if not required."""
    criterion = item.criterion
    return (
        "" if criterion.limit is None else f"{criterion.sense} {shown(item.quantity.unit, criterion.limit)}"
    )


def _criterion_row(item: Comparison) -> tuple[str, ...]:
    """Return the table row of a criterion."""
    state = f"<span class='{escape(item.state)}'>{_MARKS[item.state]} {escape(item.state)}</span>"
    return (
        state,
        _cell(item.quantity.text),
        escape(asked(item)),
        escape(interval(item.quantity)),
        _cell(item.why),
    )


def _section(name: str, quantities: Iterable[Quantity]) -> str:
    """Return the HTML of a section of quantities."""
    rows = (
        (
            _cell(item.text),
            escape(interval(item)),
            f"<span class='aside'>{escape(item.how)}</span>"
            + (f"<br><b>{escape(item.missing)}</b>" if item.missing else ""),
        )
        for item in quantities
    )
    return f"<h3>{escape(name)}</h3>" + _table(("what", "value", "how it was found"), rows, numbers=(1,))


def _happened(table: Table) -> str:
    """Return the HTML of a table of events."""
    head = f"<h3>{escape(table.title)}</h3>"
    if not table.rows:
        return f"{head}<p class='note'>{escape(table.empty)}</p>"
    numbers = [n for n, value in enumerate(table.rows[0]) if isinstance(value, int | float)]
    return head + _table(
        table.columns, ([_cell(value) for value in row] for row in table.rows), numbers=numbers
    )


def _figure(item: Series, png: bytes | None) -> str:
    """Return the HTML of a figure."""
    caption = f"<b>{escape(item.title)}</b><span class='note'>{escape(item.how)}</span>"
    if png is None:
        return f"<figure><figcaption>{caption}{escape(item.missing)}</figcaption></figure>"
    data = base64.b64encode(png).decode()
    return (
        f"<figure><figcaption>{caption}</figcaption>"
        f"<img alt='{escape(item.title)}' src='data:image/png;base64,{data}'></figure>"
    )


def _table(head: Iterable[str], rows: Iterable[Iterable[str]], numbers: Iterable[int] = ()) -> str:
    """Return the HTML of a table."""
    aligned = set(numbers)

    def number_class(column: int) -> str:
        return " class='number'" if column in aligned else ""

    columns = "".join(f"<th{number_class(n)}>{escape(name)}</th>" for n, name in enumerate(head))
    body = "".join(
        "<tr>" + "".join(f"<td{number_class(n)}>{cell}</td>" for n, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<table>{f'<thead><tr>{columns}</tr></thead>' if columns else ''}<tbody>{body}</tbody></table>"


def _cell(value: object) -> str:
    """Return the HTML of a value."""
    return escape(f"{value:.4g}" if isinstance(value, float) else str(value))
