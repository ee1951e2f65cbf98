"""Present the settings proposed from strikes, and ask for changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from pydantic import TypeAdapter

from analysis.waves.first_settings import Proposal, Trouble
from daq_service.cli.doctor.spike import HARDWARE_CURE
from daq_service.cli.set_up.bench import Bench
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.errors import RigError
from daq_service.shared_file import load_module_toml

REMEDIES: Mapping[Trouble, str] = {
    trouble: remedy.format(cure=HARDWARE_CURE)
    for trouble, remedy in TypeAdapter(dict[Trouble, str]).validate_python(load_module_toml(__file__)).items()
}


def propose_and_store_values(dialogue: Dialogue, bench: Bench, *, asks: bool) -> None:
    """Propose values from the strikes and store the accepted or entered ones in ``bench``.

    With ``asks`` it blocks for the answers and asks again until the values go together. Only prints if
    nothing was struck or no trigger level can be proposed. Raises RigError if, without questions, the values
    do not go together, UsageError if the answers end, RecordError as `Bench.propose_values`.
    """
    proposal = bench.propose_values()
    if proposal is None:
        dialogue.report("nothing was struck: level, slope, ranges and holdoff are not yet your rig's own")
        return
    for position, trouble in proposal.troubles.items():
        dialogue.report(f"{position}      {REMEDIES[trouble]}")
    if proposal.trigger_level_v is None:
        return
    for line in format_proposal(proposal):
        dialogue.report(f"take   {line}")
    taken = not asks or dialogue.ask_yes_or_no("accept", "Take these values", default="yes")
    while True:
        if not taken:
            proposal = _ask_record_settings(dialogue, bench, proposal)
        try:
            bench.accept_proposal(proposal)
        except ValueError as error:
            if not asks:
                raise RigError(f"what the strikes propose does not go together: {error}") from error
            dialogue.report(f"  {error}")
            taken = False
        else:
            return


def _ask_record_settings(dialogue: Dialogue, bench: Bench, proposal: Proposal) -> Proposal:
    """Ask for input ranges, trigger level and slope, pre-trigger and holdoff; return the changed proposal.

    Volts and seconds; the proposed values are the defaults. "-" keeps the proposed level or pre-trigger, but
    means no holdoff, and then the ringing is 0. Blocks; raises UsageError if the answers end.
    """

    def ask_number(name: str, text: str, default: float | None) -> float | None:
        """Ask for a number until one is given; "-" gives None."""
        shown = "-" if default is None else f"{default:g}"
        return dialogue.ask(
            name, text, lambda answer: None if answer == "-" else float(answer), default=shown
        )

    ranges = {}
    for name, range_v in proposal.range_v.items():
        choices = [f"{one:g}" for one in bench.ranges_v(bench.transducers[name])]
        usual, text = f"{range_v:g}", f"Range of {name}, +-V"
        ranges[name] = dialogue.ask(f"{name}.range_v", text, float, default=usual, choices=choices)
    level_v = ask_number("trigger_level_v", "Trigger level, V", proposal.trigger_level_v)
    slopes, text = ("rising", "falling"), "Direction in which it is passed"
    slope = dialogue.ask("trigger_slope", text, str, default=slopes[not proposal.rising], choices=slopes)
    pretrigger_s = ask_number("pretrigger_s", "Time recorded before it, s", proposal.pretrigger_s)
    holdoff_s = ask_number("holdoff_s", "Holdoff after the coil's pulse, s (- for none)", proposal.holdoff_s)
    return replace(
        proposal,
        range_v=ranges,
        trigger_level_v=proposal.trigger_level_v if level_v is None else level_v,
        rising=slope == "rising",
        pretrigger_s=pretrigger_s or proposal.pretrigger_s,
        holdoff_s=holdoff_s,
        ringing_s=0.0 if holdoff_s is None else proposal.ringing_s,
    )


def format_proposal(proposal: Proposal) -> list[str]:
    """Format ranges (V), trigger, pre-trigger (us) and holdoff (ms) of a proposal, one per line.

    The proposal must have a trigger level.
    """
    ranges = ", ".join(f"{name} +-{range_v:g} V" for name, range_v in proposal.range_v.items())
    holdoff = "none" if proposal.holdoff_s is None else f"{proposal.holdoff_s * 1e3:.3g} ms"
    return [
        f"ranges {ranges}",
        f"trigger at {proposal.trigger_level_v:g} V, {'rising' if proposal.rising else 'falling'}",
        f"pre-trigger {proposal.pretrigger_s * 1e6:.3g} us",
        f"holdoff {holdoff} (ringing {proposal.ringing_s * 1e3:.3g} ms)",
    ]
