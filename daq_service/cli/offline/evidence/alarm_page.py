"""Write an explained alarm as one self-contained HTML page without scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version

from daq_service.alarms.evidence import build_evidence_sentences
from daq_service.alarms.guidance import GUIDANCE, name_contact
from daq_service.alarms.states import describe_alarm
from daq_service.alarms.transitions import build_transition
from daq_service.catalogue.rows import as_dict
from daq_service.cli.offline.evidence.figures import Picture
from daq_service.recording.reassessment.changes import NOT_COMPARED
from daq_service.recording.reassessment.explanation import Explained, Recomputed
from daq_service.web.templates import render_template

NOT_SHOWN = (*NOT_COMPARED, "averages")
"""Columns of an assessment that only the JSON has; averages are the state of chart and diagnosis."""


def describe_recomputation(found: Explained) -> str:
    """Describe in sentences whether the recomputation raises the same alarm, or why there is none."""
    recomputed = found.again
    if recomputed is None:
        return f"This alarm is not recomputed: {found.why_not}. The page shows what is stored."
    read = f"{recomputed.n_records} records of {recomputed.n_sets} sets were reassessed"
    if found.agrees:
        return (
            f"{read}, and the same set raises the same alarm: features, baseline, limits and assessments are "
            "what is stored, to the last digit."
        )
    same = any(one.set_index == found.alarm.raised_set_index for one in recomputed.raised)
    others = ", ".join(f"set {one.set_index}" for one in recomputed.raised)
    elsewhere = f"it is raised with {others}" if others else "no set raises it"
    then = "the same set raises it" if same else elsewhere
    return (
        f"{read}, and {then}; but what is stored differs in the {len(recomputed.differences)} points below."
    )


def render_alarm_page(found: Explained, pictures: Sequence[Picture]) -> bytes:
    """Build the HTML page of an alarm, in UTF-8, with its evidence, assessment, guidance and figures."""
    recomputed = () if found.again is None else found.again.assessments
    of_set = next((row for row in recomputed if row.set_index == found.alarm.raised_set_index), None)
    assessment = {} if of_set is None else as_dict(of_set)
    return render_template(
        "alarm.html.j2",
        title=f"Alarm {found.alarm.id}: {describe_alarm(found.alarm).headline}",
        found=found,
        sentences=_describe_evidence(found),
        pictures=pictures,
        recomputation=describe_recomputation(found),
        assessment={name: assessment[name] for name in assessment if name not in NOT_SHOWN},
        guidance=_find_guidance(found),
        transition=build_transition,
    )


def collect_alarm_facts(found: Explained) -> dict[str, object]:
    """Collect the contents of the page and the rows behind it as values for JSON (with NumPy arrays)."""
    recomputed = found.again
    return {
        "test": found.experiment.name,
        "configuration_hash": found.experiment.configuration_hash,
        "begun_by": found.experiment.solimon_version,
        "explained_by": version("solimon"),
        "alarm": as_dict(found.alarm),
        "sentences": _describe_evidence(found),
        "guidance": _find_guidance(found),
        "history": [build_transition(event) for event in found.history],
        "agrees": found.agrees,
        "why_not_recomputed": found.why_not or None,
        "description": describe_recomputation(found),
        "recomputed": None if recomputed is None else _collect_recomputed_facts(recomputed),
    }


def _collect_recomputed_facts(recomputed: Recomputed) -> dict[str, object]:
    """Collect the recomputed alarms, differences, baseline, assessments and mean records for JSON."""
    pulses = recomputed.pulses
    return {
        "n_sets": recomputed.n_sets,
        "n_records": recomputed.n_records,
        "raised": [asdict(one) for one in recomputed.raised],
        "differences": [asdict(one) for one in recomputed.differences],
        "baseline": None if recomputed.baseline is None else as_dict(recomputed.baseline),
        "assessments": [as_dict(row) for row in recomputed.assessments],
        "measured": [as_dict(row) for row in recomputed.measured],
        "shots_without_psw": [{"set_index": index, "n": n} for index, n in recomputed.silent.items()],
        "pulses": None if pulses is None else asdict(pulses),
    }


def _find_guidance(found: Explained) -> dict[str, object] | None:
    """Return the guidance for the alarm, with the configured contact; None for a kind without guidance."""
    if (guidance := GUIDANCE.get(found.alarm.kind)) is None:
        return None
    contacts = found.experiment.configuration.get("alarms", {}).get("contacts", {})
    return {**asdict(guidance), "contact": name_contact(found.alarm.kind, contacts)}


def _describe_evidence(found: Explained) -> list[str]:
    """Describe the stored evidence of the alarm in sentences, with the baseline if it was recomputed."""
    baseline = None if found.again is None else found.again.baseline
    return build_evidence_sentences(found.alarm, {} if baseline is None else {baseline.id or 0: baseline})
