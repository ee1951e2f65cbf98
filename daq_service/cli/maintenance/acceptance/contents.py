"""Contents of an acceptance report, in the shape of its JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version

from daq_service.cli.maintenance.acceptance import conduct, faults, sets
from daq_service.cli.maintenance.acceptance.criteria import Comparison, compare_criteria, determine_outcome
from daq_service.cli.maintenance.acceptance.evidence import Evidence
from daq_service.cli.maintenance.acceptance.quantity import Quantity, Series, Table
from daq_service.cli.maintenance.acceptance.readings import list_readings
from daq_service.cli.maintenance.acceptance.series import yield_series
from daq_service.cli.maintenance.acceptance.texts import Criterion
from daq_service.clock import format_utc

SHAPE = "1"
"""Version of the JSON; it changes when a key is removed or changes its meaning."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AcceptanceReport:
    """Contents of page and JSON; ``gaps`` are ranges of hours."""

    made_utc: str
    made_by: str
    identity: Mapping[str, str]
    comparisons: Sequence[Comparison]
    quantities: Sequence[Quantity]
    tables: Sequence[Table]
    series: Sequence[Series]
    notes: Sequence[str]
    gaps: Sequence[tuple[float, float]]

    @property
    def outcome(self) -> str:
        """Return the outcome of all criteria: "pass", "fail" or "incomplete"."""
        return determine_outcome(self.comparisons)


def build_report(evidence: Evidence, criteria: Sequence[Criterion]) -> AcceptanceReport:
    """Compute quantities, comparisons, tables and series of the acceptance report from its evidence."""
    quantities = [
        *sets.count_sets_and_records(evidence),
        *conduct.compute_time_quantities(evidence),
        *conduct.compute_recorder_quantities(evidence),
        *conduct.compute_growth_quantities(evidence, "resident_bytes"),
        *conduct.compute_growth_quantities(evidence, "open_handles"),
        *conduct.compute_disk_quantities(evidence),
        *conduct.compute_clock_quantities(evidence),
        *faults.compute_fault_quantities(evidence),
    ]
    return AcceptanceReport(
        made_utc=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        made_by=f"solimon {version('solimon')}",
        identity=_describe_identity(evidence),
        comparisons=compare_criteria(criteria, {item.name: item for item in quantities}),
        quantities=quantities,
        tables=[
            sets.build_gap_table(evidence),
            sets.build_shortfall_table(evidence),
            conduct.build_restart_table(evidence),
            faults.build_fault_table(evidence),
            faults.build_clock_step_table(evidence),
            Table("flags", Counter(evidence.flags).most_common()),
            faults.build_damage_table(evidence),
        ],
        series=list(yield_series(evidence)),
        notes=list(_list_notes(evidence)),
        gaps=[(gap.from_h, gap.until_h) for gap in sets.list_gaps(evidence)],
    )


def _describe_identity(evidence: Evidence) -> dict[str, str]:
    """Return the texts that identify the test, its configuration, versions and computer, by label.

    Versions of consecutive recorders are listed once each, in order.
    """
    experiment, provenance = evidence.experiment, evidence.provenance
    runs = [row.payload for row in evidence.service if row.kind == "recorder_started"]
    versions = dict.fromkeys(_join_names_and_values(run.get("versions", {})) for run in runs)
    unknown = "unknown: no set can be read"
    configuration = evidence.settings
    return {
        "test": experiment.name,
        "configuration": experiment.configuration_hash,
        "data folder": str(evidence.folder.absolute()),
        "hour 0": format_utc(experiment.epoch_utc_ns, 3),
        "until": format_utc(evidence.now_ns, 3),
        "clock": experiment.clock,
        "state": "a copy of a test" if evidence.is_copy else evidence.recorder.description,
        "positions": ", ".join(
            f"{name} ({place.method.replace('_', ' ')})" for name, place in configuration.positions.items()
        ),
        "instruments": _join_names_and_values(
            {"rig": configuration.rig.kind, **provenance.get("rig_identity", {})}
        ),
        "begun by": f"solimon {experiment.solimon_version}",
        "versions": "; then ".join(item for item in versions if item) or "unknown: no recorder reported them",
        "machine": ", ".join(
            filter(
                None,
                [provenance.get("host"), provenance.get("platform"), f"Python {provenance.get('python')}"],
            )
        )
        if provenance
        else unknown,
    }


def _join_names_and_values(values: Mapping[str, object]) -> str:
    """Join names and values to one text: ``rig simulated, seed 7``; empty without values."""
    return ", ".join(f"{name} {value}" for name, value in values.items())


def _list_notes(evidence: Evidence) -> list[str]:
    """List notes on sets without machine readings, simulated time, a running test, and `verify`."""
    machine_readings, notes = list_readings(evidence), []
    indices = {row.set_index for row in evidence.sets if row.n_taken}
    n_lacking = len(indices) - len({reading.set_index for reading in machine_readings} & indices)
    if n_lacking:
        notes.append(
            f"{n_lacking} of {len(indices)} sets have no reading of the machine: an earlier solimon took "
            "them, or a recorder took over what another one left."
        )
    if evidence.experiment.clock != "wall":
        notes.append(
            "Simulated time: hours are those of the test; the wall time of the line is the computer's."
        )
    if evidence.recorder.status == "running":
        notes.append("The test is still running: later sets are not included.")
    if evidence.verified is not None:
        notes += [f"verify, {item.file}: {item.description}" for item in evidence.verified.damage]
        notes += evidence.verified.notes
    return notes


def report_to_json(report: AcceptanceReport) -> dict[str, object]:
    """Convert the report to a JSON object; units are values, or the last part of a key.

    Its key ``solimon_acceptance_report`` has the version of the format, `SHAPE`.
    """
    return {
        "solimon_acceptance_report": SHAPE,
        "made_utc": report.made_utc,
        "made_by": report.made_by,
        "outcome": report.outcome,
        "criteria": [
            asdict(item.criterion)
            | {name: getattr(item.quantity, name) for name in ("unit", "value", "low", "high")}
            | {"state": item.state, "reason": item.reason}
            for item in report.comparisons
        ],
        "identity": dict(report.identity),
        "quantities": {
            item.name: {key: value for key, value in asdict(item).items() if key != "name"}
            for item in report.quantities
        },
        "tables": {
            table.name: [dict(zip(table.text.columns, row, strict=True)) for row in table.rows]
            for table in report.tables
        },
        "series": {
            item.name: {
                "unit": item.text.unit,
                "how": item.text.how,
                "hours": list(item.hours),
                "values": list(item.values),
                "missing": item.missing,
            }
            for item in report.series
        },
        "notes": list(report.notes),
    }
