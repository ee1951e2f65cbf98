"""Guidance for each kind of alarm: one table for the page, the API and the how-to.

`docs/how-to/my-alarm-what-now.md` shows `as_markdown`; a test compares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Guidance:
    """What an operator needs to know of a kind of alarm.

    Attributes
    ----------
    meaning, limitations
        What has been found, and what that does not prove.
    checks
        Likely causes, in the order in which to look.
    short
        The same in a sentence or two, for a message.
    contact
        Who decides.
    """

    meaning: str
    limitations: str
    checks: tuple[str, ...]
    short: str
    contact: str


GUIDANCE: Mapping[str, Guidance] = {
    "wall_change": Guidance(
        meaning="sets here are no longer like the baseline: by chart or diagnosis, or 3 of the last 5",
        limitations="that it is corrosion, nor how deep",
        checks=(
            "the control position: does it move, too?",
            "the contributions in the evidence: which feature",
            "temperature, a knock, work at the rig at that hour",
        ),
        short="Does the control position move, too? Then which feature contributes; temperature.",
        contact="who is responsible for the wall, with the evidence",
    ),
    "transducer_change": Guidance(
        meaning="sets here are no longer like the baseline, for a sure cause: sensor, contact or temperature",
        limitations="that the wall is as it was: behind such a change a thin one may hide",
        checks=(
            "the cause in the message, and what it asks for",
            "striker, beads, sensor, cable; how the chain stands",
            "put right, a new baseline: until then nothing watches the wall here",
        ),
        short="The message names the cause; put it right, then record a new baseline.",
        contact="who looks after the rig",
    ),
    "not_assessed": Guidance(
        meaning="the baseline here has no limits: nothing is judged, nothing watches the wall",
        limitations="anything about the wall",
        checks=(
            "the message: too few sets, or a feature that never changes",
            "what kept sets out: a hold, poor shots, a missing rig",
            "that put right, `solimon renew-baseline`",
        ),
        short="The message says why there are no limits; put it right, then `solimon renew-baseline`.",
        contact="who looks after the rig",
    ),
    "no_reflection": Guidance(
        meaning="no reflected wave in most shots, consecutive sets; the transducer is disabled",
        limitations="whether the wall is open or the chain has lost contact",
        checks=(
            "leaks, by eye",
            "does the chain stand on the wall?",
            "the last waveforms: incident wave there, reflected one gone",
        ),
        short="Look for leaks, and whether the chain stands on the wall; call who is responsible at once.",
        contact="who is responsible for the wall, at once",
    ),
    "thickness_low": Guidance(
        meaning="the probe reads a loss beyond the limit, 3 readings of 5",
        limitations="the thinnest spot: it is the mean under the beam",
        checks=(
            "the 95 % interval in the evidence",
            "the echo: one clear back wall?",
            "couplant, cable, temperature",
        ),
        short="See the interval in the evidence; has the echo one clear back wall? Then couplant, cable.",
        contact="who is responsible for the wall",
    ),
    "few_valid_shots": Guidance(
        meaning="several sets running with too few valid shots",
        limitations="anything about the wall",
        checks=(
            "flags of the newest shots",
            "coil and striker: does it lift and fall?",
            "sensor, cable, range",
        ),
        short="Flags of the newest shots; does the striker lift and fall? Then sensor, cable, range.",
        contact="who looks after the rig",
    ),
    "transducer_disabled": Guidance(
        meaning="the transducer strikes no more: too few valid shots for long, or a person's order",
        limitations="that the others suffer: they go on",
        checks=(
            "who or what disabled it (the message)",
            "coil's temperature",
            "as for `few_valid_shots`; then `solimon enable`",
        ),
        short="The message names who or what disabled it. Fix that, then run `solimon enable`.",
        contact="who looks after the rig",
    ),
    "instruments_unavailable": Guidance(
        meaning="instruments do not answer, or belong to somebody else",
        limitations="that data are lost: missed sets have rows",
        checks=(
            "power and cables of chassis and boards",
            "another program that has the board",
            "`solimon doctor`; did the recorder end, start it again",
        ),
        short="Power and cables of chassis and boards; a program that has them; `solimon doctor`.",
        contact="who looks after the rig",
    ),
    "data_corrupt": Guidance(
        meaning="stored files cannot be read, or are gone",
        limitations="that new ones will be",
        checks=(
            "`solimon verify`",
            "the disk's health",
            "`solimon repair` with a [backup](back-up.md)",
        ),
        short="`solimon verify`, the disk's health, then `solimon repair` with a backup.",
        contact="who looks after the computer",
    ),
    "disk_space": Guidance(
        meaning="little of the volume is free; `high`: nothing more is stored",
        limitations="that the data folder is what fills it",
        checks=(
            "what else lies on the volume",
            "`solimon status`: enough for the rest?",
            "move other data away, never files of the folder",
        ),
        short="Move other data off the volume; never take files out of the data folder.",
        contact="who looks after the computer",
    ),
    "write_failed": Guidance(
        meaning="the disk refuses; what is taken waits",
        limitations="that anything is lost yet",
        checks=(
            "is the disk there, and writable?",
            "a scanner or another program on the folder",
            "do **not** stop the test before it clears",
        ),
        short="Is the disk there and writable? Do not stop the test before this clears.",
        contact="who looks after the computer, at once",
    ),
    "clock_unverified": Guidance(
        meaning="the computer's clock cannot be believed after a restart; the test waits",
        limitations="that the data so far have wrong times",
        checks=(
            "the clock",
            "its synchronisation",
            "set it, or `solimon trust-clock` if it is right",
        ),
        short="Set the computer's clock, or `solimon trust-clock` if it is right.",
        contact="who looks after the computer",
    ),
    "recorder_not_running": Guidance(
        meaning="no recorder stores sets: it fails again and again, or does not run",
        limitations="that stored data are damaged, or that the supply is off",
        checks=("end of `logs/recorder.log`", "`solimon doctor`", "start it with `solimon run`"),
        short="Read `logs/recorder.log`, then start it with `solimon run` or its service.",
        contact="the person responsible for the rig",
    ),
    "web_not_responding": Guidance(
        meaning="the web service stalls, or ended without notice; the recorder goes on",
        limitations="that sets are missed",
        checks=("end of `logs/web.log`", "memory of the computer", "restart `solimon serve`"),
        short="Read `logs/web.log`, then restart `solimon serve` or its service.",
        contact="the person responsible for the computer",
    ),
    "supply_not_responding": Guidance(
        meaning="no reading of the drive; its output is **unknown**",
        limitations="that it is off",
        checks=(
            "the instrument's own display",
            "cable, port",
            "another program that has the port",
        ),
        short="The output is unknown: read the instrument's own display, then cable and port.",
        contact="who looks after the cell",
    ),
    "supply_off_unexpectedly": Guidance(
        meaning="the output is off, and nobody ordered that",
        limitations="why, unless a protection is named",
        checks=(
            "the named protection",
            "mains and front panel",
            "the cell: a short? then `solimon supply --on`",
        ),
        short="See which protection is named; mains, front panel, a short in the cell.",
        contact="who looks after the cell",
    ),
    "supply_on_unexpectedly": Guidance(
        meaning="the output was found on without a command, and was switched off",
        limitations="who or what switched it on",
        checks=(
            "the supply's own display: is it off?",
            "mains return, front panel, another program",
            "isolate the supply before you reach in",
        ),
        short="Check that the output is off; isolate the supply; find what switched it on.",
        contact="the contact for the cell",
    ),
    "supply_switch_off_pending": Guidance(
        meaning="the output must be off and has not been read as off",
        limitations="that it is on, or off",
        checks=("switch the supply off by hand, now", "cable and port", "the supply's own display"),
        short="Switch the supply off by hand immediately; then check cable and port.",
        contact="the contact for the cell, at once",
    ),
    "supply_deviation": Guidance(
        meaning="voltage or current has been away from the command for minutes",
        limitations="which lead is off, or that the cell corrodes",
        checks=("leads and electrodes", "level of the bath", "the setpoint at the supply"),
        short="Check leads, bath and setpoint: the cell may not corrode.",
        contact="the contact for the cell",
    ),
    "supply_above_cap": Guidance(
        meaning="voltage or current was above its configured cap; the output was switched off",
        limitations="whether the supply or its setting is at fault",
        checks=(
            "the setpoint at the supply",
            "sense leads",
            "the cell, by eye; only then `solimon supply --on`",
        ),
        short="Find out why the supply gave more than its cap before you switch on.",
        contact="the contact for the cell, at once",
    ),
    "climate_not_responding": Guidance(
        meaning="no reading of the climate probe",
        limitations="that the temperature is steady",
        checks=("its cable and port", "its power", "another program that has the port"),
        short="Check the probe's cable, port and power.",
        contact="the contact for the instruments",
    ),
    "supply_current_limit": Guidance(
        meaning="the current is at its limit, the voltage no longer held",
        limitations="that it is dangerous: the supply holds the limit",
        checks=(
            "electrodes that touch",
            "level and strength of the electrolyte",
            "the configured limit",
        ),
        short="Electrodes that touch? Level and strength of the electrolyte; the configured limit.",
        contact="who looks after the cell",
    ),
    "interlock_tripped": Guidance(
        meaning="solimon switched the drive off and keeps it off",
        limitations="that it is safe to switch on",
        checks=(
            "the message: the reason",
            "the cell, by eye",
            "`/api/v1/environment`; only then `solimon supply --on`",
        ),
        short="The drive stays off: see why, and the cell by eye, before anybody switches it on.",
        contact="who looks after the cell, at once",
    ),
    "supply_watchdog_trip": Guidance(
        meaning="the drive was on without a recorder, so it was switched off",
        limitations="that the recorder runs now",
        checks=(
            "is it running?",
            "why it ended: `logs/`",
            "as for `interlock_tripped`",
        ),
        short="Does the recorder run, and why did it end? See the cell before switching on.",
        contact="who looks after the cell",
    ),
}
"""By kind of alarm, the gravest for the wall first."""


def in_order(steps: Sequence[str]) -> str:
    """Return numbered steps as one sentence."""
    parts = [f"{number} {step}" for number, step in enumerate(steps, start=1)]
    return "".join(part + (" " if part.endswith("?") else "; ") for part in parts).rstrip("; ")


def as_markdown() -> str:
    """Return the guidance as the Markdown table of the how-to."""
    lines = ["| Kind | It says | It does not say | Look first | Whom to call |", "|---|---|---|---|---|"]
    for kind, guidance in GUIDANCE.items():
        cells = (
            f"`{kind}`",
            guidance.meaning,
            guidance.limitations,
            in_order(guidance.checks),
            guidance.contact,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
