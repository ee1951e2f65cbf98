"""What to look at first, by kind of alarm: the short form of docs/how-to/my-alarm-what-now.md."""

from __future__ import annotations

from collections.abc import Mapping

GUIDANCE: Mapping[str, str] = {
    "wall_change": "Does the control position move, too? Then which feature contributes; temperature.",
    "hole": "Look for leaks, and whether the chain stands on the wall; call who is responsible at once.",
    "thickness": "See the interval in the proof; has the echo one clear back wall? Then couplant, cable.",
    "no_data": "Flags of the newest shots; does the striker lift and fall? Then sensor, cable, range.",
    "retired": "The message says who or what retired it; mend that, then `solimon reinstate`.",
    "rig_unavailable": "Power and cables of chassis and boards; a program that has them; `solimon doctor`.",
    "data_damaged": "`solimon verify`, the disk's health, then `solimon repair` with a backup.",
    "disk_space": "Move other data off the volume; never take files out of the data folder.",
    "storage_unavailable": "Is the disk there and writable? Do not stop the test before this clears.",
    "clock_doubted": "Set the computer's clock, or `solimon trust-clock` if it is right.",
    "supply_lost": "The output is unknown: read the instrument's own display, then cable and port.",
    "supply_off_unexpectedly": "See which protection is named; mains, front panel, a short in the cell.",
    "supply_limit": "Electrodes that touch? Level and strength of the electrolyte; the configured limit.",
    "interlock_tripped": "The drive stays off: see why, and the cell by eye, before anybody switches it on.",
    "supply_unwatched": "Does the recorder run, and why did it end? See the cell before switching on.",
}
"""Every kind of alarm that there is: a test compares them with that page."""
