"""Interface of the reproduction's figures and tables.

An item names the computations (`Job`) it needs, and turns their results and the test's evidence into a
drawing, tables and our values of the paper's quantities. Items know nothing of each other, of files or of
processes; `daq_service.cli.reproduce.run` brings them together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daq_service.cli.reproduce.evidence import Evidence, FloatArray, Series
from daq_service.cli.reproduce.texts import TEXTS, Caption

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class NotAvailableError(Exception):
    """A quantity, or a complete figure, is not available from this test; the message has the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A computation of the models: a function of `daq_service.cli.reproduce.models`, run by an executor.

    Equal jobs are computed once, so the arguments must be hashable and picklable.
    """

    function: Callable[..., object]
    arguments: tuple[Hashable, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Our value of one of the paper's quantities, in the paper's unit.

    Attributes
    ----------
    value
        None where it is not available, or where it is no number.
    words
        Addition to the number; may be empty.
    reason
        Why `value` is not available; empty where it is.
    """

    value: float | None = None
    words: str = ""
    reason: str = ""


def make_value(value: float | None, words: str = "", *, reason: str = "") -> Found:
    """Create a computed value; None, NaN or infinity becomes a missing one with the reason."""
    if value is None or not math.isfinite(value):
        return Found(words=words, reason=reason or "not a finite number")
    return Found(value=float(value), words=words)


def no_value(reason: str) -> Found:
    """Create a missing value with the reason that the report shows."""
    return Found(reason=reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Columns of a CSV file, of equal length; the name of a column ends with its unit."""

    columns: Mapping[str, Sequence[object] | NDArray[np.generic]]

    def __post_init__(self) -> None:
        """Raise ValueError if the columns differ in length."""
        lengths = {name: len(values) for name, values in self.columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"columns of a table differ in length: {lengths}")

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Iterate over the rows of the table, each with one value per column."""
        return zip(*self.columns.values(), strict=True)


def stack_columns(test: Evidence, columns: Callable[[Series], Mapping[str, FloatArray]]) -> Table:
    """Stack columns of the sets of all transducers, with position, set and hour, into one table.

    Raises ValueError if the transducers have different columns.
    """
    table: dict[str, list[object]] = {}
    for name, pulses in test.pulses.items():
        part = {"set_index": pulses.set_index, "due_h": pulses.hour_h, **columns(pulses)}
        table.setdefault("position", []).extend([name] * pulses.hour_h.size)
        for key, values in part.items():
            table.setdefault(key, []).extend(values.tolist())
    return Table(columns=table)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Material:
    """Input of an item.

    Attributes
    ----------
    evidence
        Of the test; None where no chosen item needs one.
    results
        Of the item's jobs, by the names it gave them; an exception where a job failed.
    """

    evidence: Evidence | None
    results: Mapping[str, object]

    def result(self, name: str) -> Any:
        """Return the result of a job by the item's name for it.

        Raises
        ------
        NotAvailableError
            The model refused or failed.
        KeyError
            The item has no such job.
        """
        value = self.results[name]
        if isinstance(value, Exception):
            raise NotAvailableError(f"the model refuses: {value}") from value
        return value

    @property
    def test(self) -> Evidence:
        """Return the evidence of the test; raise NotAvailableError if there is none."""
        if self.evidence is None:
            raise NotAvailableError("no test was run or read")
        return self.evidence

    @property
    def transducers(self) -> list[str]:
        """Return the names of the solitary-wave transducers with sets; raise NotAvailableError if none."""
        if not self.test.pulses:
            raise NotAvailableError("the test has no solitary-wave transducer")
        return list(self.test.pulses)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Product:
    """Output of an item.

    Attributes
    ----------
    drawing
        None for a table.
    tables
        By the ending of their file's name: the empty one is the item's own, ``mesh`` is ``fig05_mesh.csv``.
    found
        Our values by quantity.
    notes
        What a reader of the figure should know: whole sentences.
    """

    drawing: Figure | None = None
    tables: Mapping[str, Table] = field(default_factory=dict)
    found: Mapping[str, Found] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """A figure or table of the paper, or the list of its slips.

    Attributes
    ----------
    name
        As in ``--only`` and in file names.
    needs_test
        Whether it draws measurements.
    jobs
        By a name of the item's own.
    """

    name: str
    make: Callable[[Material], Product]
    needs_test: bool = False
    jobs: Mapping[str, Job] = field(default_factory=dict)

    @property
    def caption(self) -> Caption:
        """Return title and caption of the item; raise KeyError if ``texts.toml`` has none."""
        return TEXTS.captions[self.name]
