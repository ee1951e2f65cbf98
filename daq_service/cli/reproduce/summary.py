"""Count the paper's values by kind, the predictions by agreement, and assess the paper's claims by them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

from daq_service.cli.reproduce.comparison import AGREEMENTS, Row
from daq_service.cli.reproduce.paper_values import Kind
from daq_service.cli.reproduce.texts import TEXTS, find_remark

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


def count_values(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Count the paper's values by kind (``kinds``), and the predictions by agreement (``predictions``)."""
    counts = Counter([*(row.kind for row in rows), *(row.agreement for row in rows)])
    return {
        "kinds": {kind: counts[kind] for kind in get_args(Kind)},
        "predictions": {name: counts[name] for name in AGREEMENTS},
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
    deviations = [row.deviation_percent for row in rows if row.deviation_percent is not None]
    agreeing = [row.agreement for row in rows if row.agreement in list(AGREEMENTS)[:-3]]
    n, n_compared = len(agreeing), len(deviations)
    return ClaimResult(
        claim=claim,
        result=RESULTS[3 if not n_compared else 0 if n == n_compared else 1 if n else 2],
        agreement=max(agreeing, key=list(AGREEMENTS).index, default=""),
        n_agreeing=n,
        n_compared=n_compared,
        deviation_percent=(min(deviations), max(deviations)) if deviations else None,
        items=list(dict.fromkeys(row.item for row in rows)),
        quantities=[row.quantity for row in rows],
    )
