"""Compute tables 1 and 2."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from daq_service.cli.reproduce import models
from daq_service.cli.reproduce.item import Found, Item, Job, Material, Product, Table, found, missing
from daq_service.cli.reproduce.paper_values import values_of
from simulator.zener.table_2 import Table2Row

_FIELDS = {
    "impact_speed": "impact_speed_m_per_s",
    "particle_speed": "particle_speed_m_per_s",
    "isw_ratio": "isw_ratio",
    "inelasticity": "inelasticity",
    "restitution": "restitution",
    "amplitude_ratio": "amplitude_ratio",
    "contact_time": "contact_time",
    "tof": "tof_us",
}


def make_table1(material: Material) -> Product:
    """Return the positions of the test: method, size of the corroded square, sets."""
    test = material.test
    methods = {**dict.fromkeys(test.pulses, "solitary_wave"), **dict.fromkeys(test.echoes, "pulse_echo")}
    places: dict[str, Any] = {**test.pulses, **test.echoes}
    names = sorted(places)
    table = Table(
        columns={
            "position": names,
            "method": [methods[name] for name in names],
            "label": [places[name].label for name in names],
            "patch_m": [places[name].patch_m for name in names],
            "sets": [int(places[name].hour_h.size) for name in names],
        }
    )
    values: dict[str, Found] = {
        f"patch_{name}": missing(f"the test has no position {name}")
        if name not in places or places[name].patch_m is None
        else found(1e3 * places[name].patch_m, methods[name])
        for name in "ABC"
    }
    values["loss_D"] = _loss_at_d(material)
    values["end"] = found(test.last_h)
    values["sets"] = found(float(test.counts["sets"]), f"to hour {test.last_h:g}")
    return Product(tables={"": table}, found=values)


def _loss_at_d(material: Material) -> Found:
    known = [trace for trace in material.test.traces.get("D", ()) if "depth_fraction" in trace.truth]
    if not known:
        return missing("nobody measured the wall at D")
    return found(100.0 * float(known[-1].truth["depth_fraction"]), "the twin's truth")


def make_table2(material: Material) -> Product:
    """Return Zener's model over the drop height, rounded as in the paper."""
    rows: tuple[Table2Row, ...] = material.result("rows")
    values = {
        f"{name}_{case}": found(float(asdict(row)[field]))
        for case, row in enumerate(rows, 1)
        for name, field in _FIELDS.items()
    }
    columns: dict[str, list[Any]] = {"case": list(range(1, len(rows) + 1))}
    for field in asdict(rows[0]):
        columns[field] = [asdict(row)[field] for row in rows]
    same = sum(value.value == values[value.quantity].value for value in values_of("table2"))
    return Product(
        tables={"": Table(columns=columns)},
        found=values,
        notes=(f"{same} of {len(values_of('table2'))} printed numbers agree digit for digit.",),
    )


TABLE1 = Item(
    name="table1",
    title="Table 1. Monitoring positions",
    shows="Positions of the test as configured.",
    make=make_table1,
    needs_test=True,
)
TABLE2 = Item(
    name="table2",
    title="Table 2. Zener's model over the drop height",
    shows="Closed forms of eqs 9 to 13 with the roundings that give the paper's digits.",
    make=make_table2,
    jobs={"rows": Job(function=models.zeners_table)},
)
