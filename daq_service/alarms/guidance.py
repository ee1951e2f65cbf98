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
    says, does_not_say
        What has been found, and what that does not prove.
    look_first
        Likely causes, in the order in which to look.
    short
        The same in a sentence or two, for a message.
    call
        Who decides.
    """

    says: str
    does_not_say: str
    look_first: tuple[str, ...]
    short: str
    call: str


GUIDANCE: Mapping[str, Guidance] = {
    "wall_change": Guidance(
        says="sets here are no longer like the baseline: by chart or cause, or 3 of the last 5 judged ones",
        does_not_say="that it is corrosion, nor how deep",
        look_first=(
            "the control position: does it move, too?",
            "the contributions in the proof: which feature",
            "temperature, a knock, work at the rig at that hour",
        ),
        short="Does the control position move, too? Then which feature contributes; temperature.",
        call="who is responsible for the wall, with the proof",
    ),
    "transducer_change": Guidance(
        says="sets here are no longer like the baseline, for a sure cause: sensor, contact or temperature",
        does_not_say="that the wall is as it was: behind such a change a thin one may hide",
        look_first=(
            "the cause in the message, and what it asks for",
            "striker, beads, sensor, cable; how the chain stands",
            "put right, a new baseline: until then nothing watches the wall here",
        ),
        short="The message names the cause; put it right, then record a new baseline.",
        call="who looks after the rig",
    ),
    "not_judged": Guidance(
        says="the baseline here has no limits: nothing is judged, nothing watches the wall",
        does_not_say="anything about the wall",
        look_first=(
            "the message: too few sets, or a feature that never changes",
            "what kept sets out: a hold, poor shots, a missing rig",
            "that put right, `solimon renew-baseline`",
        ),
        short="The message says why there are no limits; put it right, then `solimon renew-baseline`.",
        call="who looks after the rig",
    ),
    "hole": Guidance(
        says="no reflected wave in most shots, sets running; the transducer is retired",
        does_not_say="whether the wall is open or the chain has lost contact",
        look_first=(
            "leaks, by eye",
            "does the chain stand on the wall?",
            "the last waveforms: incident wave there, reflected one gone",
        ),
        short="Look for leaks, and whether the chain stands on the wall; call who is responsible at once.",
        call="who is responsible for the wall, at once",
    ),
    "thickness": Guidance(
        says="the probe reads a loss beyond the limit, 3 readings of 5",
        does_not_say="the thinnest spot: it is the mean under the beam",
        look_first=(
            "the 95 % interval in the proof",
            "the echo: one clear back wall?",
            "couplant, cable, temperature",
        ),
        short="See the interval in the proof; has the echo one clear back wall? Then couplant, cable.",
        call="who is responsible for the wall",
    ),
    "no_data": Guidance(
        says="several sets running with too few valid shots",
        does_not_say="anything about the wall",
        look_first=(
            "flags of the newest shots",
            "coil and striker: does it lift and fall?",
            "sensor, cable, range",
        ),
        short="Flags of the newest shots; does the striker lift and fall? Then sensor, cable, range.",
        call="who looks after the rig",
    ),
    "retired": Guidance(
        says="the transducer strikes no more: too few valid shots for long, or a person's order",
        does_not_say="that the others suffer: they go on",
        look_first=(
            "who or what disabled it (the message)",
            "coil's temperature",
            "as for `no_data`; then `solimon enable`",
        ),
        short="The message names who or what disabled it. Fix that, then run `solimon enable`.",
        call="who looks after the rig",
    ),
    "rig_unavailable": Guidance(
        says="instruments do not answer, or belong to somebody else",
        does_not_say="that data are lost: missed sets have rows",
        look_first=(
            "power and cables of chassis and boards",
            "another program that has the board",
            "`solimon doctor`; did the recorder end, start it again",
        ),
        short="Power and cables of chassis and boards; a program that has them; `solimon doctor`.",
        call="who looks after the rig",
    ),
    "data_damaged": Guidance(
        says="stored files cannot be read, or are gone",
        does_not_say="that new ones will be",
        look_first=(
            "`solimon verify`",
            "the disk's health",
            "`solimon repair` with a [backup](back-up.md)",
        ),
        short="`solimon verify`, the disk's health, then `solimon repair` with a backup.",
        call="who looks after the computer",
    ),
    "disk_space": Guidance(
        says="little of the volume is free; `high`: nothing more is stored",
        does_not_say="that the data folder is what fills it",
        look_first=(
            "what else lies on the volume",
            "`solimon status`: enough for the rest?",
            "move other data away, never files of the folder",
        ),
        short="Move other data off the volume; never take files out of the data folder.",
        call="who looks after the computer",
    ),
    "storage_unavailable": Guidance(
        says="the disk refuses; what is taken waits",
        does_not_say="that anything is lost yet",
        look_first=(
            "is the disk there, and writable?",
            "a scanner or another program on the folder",
            "do **not** stop the test before it clears",
        ),
        short="Is the disk there and writable? Do not stop the test before this clears.",
        call="who looks after the computer, at once",
    ),
    "clock_doubted": Guidance(
        says="the computer's clock cannot be believed after a restart; the test waits",
        does_not_say="that the data so far have wrong times",
        look_first=(
            "the clock",
            "its synchronisation",
            "set it, or `solimon trust-clock` if it is right",
        ),
        short="Set the computer's clock, or `solimon trust-clock` if it is right.",
        call="who looks after the computer",
    ),
    "recorder_not_running": Guidance(
        says="no recorder stores sets: it fails again and again, or does not run",
        does_not_say="that stored data are damaged, or that the supply is off",
        look_first=("end of `logs/recorder.log`", "`solimon doctor`", "start it with `solimon run`"),
        short="Read `logs/recorder.log`, then start it with `solimon run` or its service.",
        call="the person responsible for the rig",
    ),
    "web_not_responding": Guidance(
        says="the web service stalls, or ended without notice; the recorder goes on",
        does_not_say="that sets are missed",
        look_first=("end of `logs/web.log`", "memory of the computer", "restart `solimon serve`"),
        short="Read `logs/web.log`, then restart `solimon serve` or its service.",
        call="the person responsible for the computer",
    ),
    "supply_lost": Guidance(
        says="no reading of the drive; its output is **unknown**",
        does_not_say="that it is off",
        look_first=(
            "the instrument's own display",
            "cable, port",
            "another program that has the port",
        ),
        short="The output is unknown: read the instrument's own display, then cable and port.",
        call="who looks after the cell",
    ),
    "supply_off_unexpectedly": Guidance(
        says="the output is off, and nobody ordered that",
        does_not_say="why, unless a protection is named",
        look_first=(
            "the named protection",
            "mains and front panel",
            "the cell: a short? then `solimon supply --on`",
        ),
        short="See which protection is named; mains, front panel, a short in the cell.",
        call="who looks after the cell",
    ),
    "supply_on_unexpectedly": Guidance(
        says="the output was found on without a command, and was switched off",
        does_not_say="who or what switched it on",
        look_first=(
            "the supply's own display: is it off?",
            "mains return, front panel, another program",
            "isolate the supply before you reach in",
        ),
        short="Check that the output is off; isolate the supply; find what switched it on.",
        call="the contact for the cell",
    ),
    "supply_switch_off_pending": Guidance(
        says="the output must be off and has not been read as off",
        does_not_say="that it is on, or off",
        look_first=("switch the supply off by hand, now", "cable and port", "the supply's own display"),
        short="Switch the supply off by hand immediately; then check cable and port.",
        call="the contact for the cell, at once",
    ),
    "supply_deviation": Guidance(
        says="voltage or current has been away from the command for minutes",
        does_not_say="which lead is off, or that the cell corrodes",
        look_first=("leads and electrodes", "level of the bath", "the setpoint at the supply"),
        short="Check leads, bath and setpoint: the cell may not corrode.",
        call="the contact for the cell",
    ),
    "supply_above_cap": Guidance(
        says="voltage or current was above its configured cap; the output was switched off",
        does_not_say="whether the supply or its setting is at fault",
        look_first=(
            "the setpoint at the supply",
            "sense leads",
            "the cell, by eye; only then `solimon supply --on`",
        ),
        short="Find out why the supply gave more than its cap before you switch on.",
        call="the contact for the cell, at once",
    ),
    "climate_not_responding": Guidance(
        says="no reading of the climate probe",
        does_not_say="that the temperature is steady",
        look_first=("its cable and port", "its power", "another program that has the port"),
        short="Check the probe's cable, port and power.",
        call="the contact for the instruments",
    ),
    "supply_limit": Guidance(
        says="the current is at its limit, the voltage no longer held",
        does_not_say="that it is dangerous: the supply holds the limit",
        look_first=(
            "electrodes that touch",
            "level and strength of the electrolyte",
            "the configured limit",
        ),
        short="Electrodes that touch? Level and strength of the electrolyte; the configured limit.",
        call="who looks after the cell",
    ),
    "interlock_tripped": Guidance(
        says="solimon switched the drive off and keeps it off",
        does_not_say="that it is safe to switch on",
        look_first=(
            "the message: the reason",
            "the cell, by eye",
            "`/api/v1/environment`; only then `solimon supply --on`",
        ),
        short="The drive stays off: see why, and the cell by eye, before anybody switches it on.",
        call="who looks after the cell, at once",
    ),
    "supply_unwatched": Guidance(
        says="the drive was on without a recorder, so it was switched off",
        does_not_say="that the recorder runs now",
        look_first=(
            "is it running?",
            "why it ended: `logs/`",
            "as for `interlock_tripped`",
        ),
        short="Does the recorder run, and why did it end? See the cell before switching on.",
        call="who looks after the cell",
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
            guidance.says,
            guidance.does_not_say,
            in_order(guidance.look_first),
            guidance.call,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
