"""Count the paper's values by kind, the predictions by agreement, and assess the paper's claims by them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict, get_args

from daq_service.cli.reproduce.comparison import AGREEMENTS, Row
from daq_service.cli.reproduce.paper_values import Kind
from daq_service.cli.reproduce.texts import TEXTS, find_remark

KINDS: Sequence[Kind] = get_args(Kind)
RESULTS = ("reproduced", "reproduced in part", "not reproduced", "not tested")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimResult:
    """A claim of the paper and our predictions of its numbers.

    Attributes
    ----------
    result
        One of `RESULTS`: all, some or none of the predictions agree, or none has numbers on both sides.
    agreement
        The widest tolerance that is needed for those that agree, as in `AGREEMENTS`; empty if none does.
    n_compared
        Predictions with numbers on both sides.
    deviation_percent
        Smallest and largest deviation of these; None without any.
    items, quantities
        Of the predictions.
    """

    claim: str
    result: str
    agreement: str
    n_agreeing: int
    n_compared: int
    deviation_percent: tuple[float, float] | None
    items: Sequence[str]
    quantities: Sequence[str]


class Counts(TypedDict):
    """The paper's values, those of each kind, and the predictions by their agreement."""

    values: int
    kinds: dict[str, int]
    predictions: dict[str, int]


def count_values(rows: Sequence[Row]) -> Counts:
    """Count the paper's values by kind, and the predictions among them by agreement."""
    kinds = Counter(row.kind for row in rows)
    agreements = Counter(row.agreement for row in rows if row.kind == "predicted")
    return {
        "values": len(rows),
        "kinds": {kind: kinds[kind] for kind in KINDS},
        "predictions": {name: agreements[name] for name in AGREEMENTS},
    }


def assess_claims(rows: Sequence[Row]) -> list[ClaimResult]:
    """Assess the paper's claims by the predictions among the rows, in the order of `RESULTS`.

    Claims of which no prediction is among the rows are left out.
    """
    of_claim: dict[str, list[Row]] = {claim.text: [] for claim in TEXTS.claims}
    for row in rows:
        if row.kind == "predicted":
            of_claim[find_remark(TEXTS.claims, f"{row.item}.{row.quantity}")].append(row)
    results = [_assess_claim(claim, chosen) for claim, chosen in of_claim.items() if chosen]
    return sorted(results, key=lambda one: RESULTS.index(one.result))


def _assess_claim(claim: str, rows: Sequence[Row]) -> ClaimResult:
    """Assess one claim by its predictions."""
    compared = [row for row in rows if row.deviation_percent is not None]
    agreeing = [row.agreement for row in compared if row.agreement != "outside"]
    deviations = [row.deviation_percent for row in compared if row.deviation_percent is not None]
    is_all = len(agreeing) == len(compared)
    return ClaimResult(
        claim=claim,
        result=RESULTS[3 if not compared else 0 if is_all else 1 if agreeing else 2],
        agreement=max(agreeing, key=list(AGREEMENTS).index, default=""),
        n_agreeing=len(agreeing),
        n_compared=len(compared),
        deviation_percent=(min(deviations), max(deviations)) if deviations else None,
        items=list(dict.fromkeys(row.item for row in rows)),
        quantities=[row.quantity for row in rows],
    )


def describe_counts(counts: Counts) -> str:
    """Describe the counts of `count_values` in two sentences."""
    kinds = ", ".join(f"{n} {kind}" for kind, n in counts["kinds"].items())
    agreements = ", ".join(f"{n} {AGREEMENTS[name]}" for name, n in counts["predictions"].items())
    return f"{counts['values']} values of the paper: {kinds}. Agreement of the predictions: {agreements}."
