"""Compute tables 1 and 2."""

from __future__ import annotations

from dataclasses import fields

from daq_service.cli.reproduce.item import Found, Item, Job, Material, Product, Table, make_value, no_value
from simulator.zener.table_2 import Table2Row, compute_table_2


def build_position_table(material: Material) -> Product:
    """Build table 1: measuring method, size of the corroded square and sets of each position.

    Raises NotAvailableError without a test.
    """
    test = material.test
    places = dict(sorted({**test.pulses, **test.echoes}.items()))
    table = Table(
        columns={
            "position": list(places),
            "method": [place.settings.method for place in places.values()],
            "label": [place.settings.label for place in places.values()],
            "patch_m": [place.settings.corrosion.size_m for place in places.values()],
            "sets": [int(place.hour_h.size) for place in places.values()],
        }
    )
    values = {f"patch_{name}": no_value(f"the test has no position {name}") for name in "ABC"}
    for name, place in places.items():
        values[f"patch_{name}"] = make_value(1e3 * place.settings.corrosion.size_m, place.settings.method)
    values["loss_D"] = _compute_loss_at_d(material)
    values["end"] = make_value(test.last_h)
    values["sets"] = make_value(float(test.counts["sets"]), f"to hour {test.last_h:g}")
    return Product(tables={"": table}, found=values)


def _compute_loss_at_d(material: Material) -> Found:
    """Return the wall loss at D in % from the last truth of the twin; without one, the reason."""
    known = [trace for trace in material.test.traces.get("D", ()) if "depth_fraction" in trace.truth]
    if not known:
        return no_value("the wall at D was not measured")
    return make_value(100.0 * known[-1].truth["depth_fraction"], "the twin's truth")


def build_zener_table(material: Material) -> Product:
    """Build table 2: Zener's model over the drop height, rounded as in the paper.

    Raises NotAvailableError if the job failed.
    """
    rows: tuple[Table2Row, ...] = material.result("rows")
    columns = {field.name: [float(getattr(row, field.name)) for row in rows] for field in fields(Table2Row)}
    values = {
        f"{name.partition('_m_per_s')[0].removesuffix('_us')}_{case}": make_value(value)
        for name, numbers in columns.items()
        for case, value in enumerate(numbers, 1)
    }
    return Product(
        tables={"": Table(columns={"case": list(range(1, len(rows) + 1)), **columns})}, found=values
    )


TABLE1 = Item(name="table1", make=build_position_table, needs_test=True)
TABLE2 = Item(name="table2", make=build_zener_table, jobs={"rows": Job(function=compute_table_2)})
