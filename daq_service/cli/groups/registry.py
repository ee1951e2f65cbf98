"""All commands of ``solimon``: section, name and summary; their options are in `groups`."""

from __future__ import annotations

from collections.abc import Mapping

SECTIONS: Mapping[str, Mapping[str, str]] = {
    "run": {
        "demo": "Run the paper's 350 h corrosion test on the twin, with dashboard.",
        "run": "Record a test and serve its dashboard; restart failed processes.",
        "record": "Record a test without the web service.",
        "serve": "Serve dashboard and API of one or more tests; record nothing.",
        "supply-process": "Run the supply process; never switches the output on.",
        "setup": "Set up boards and transducers interactively.",
        "init": "Write a commented configuration file and its JSON Schema.",
        "check-config": "Validate a configuration; print sets, shots, disk use and end.",
        "service": "Write systemd or Windows service files for a test.",
        "doctor": "Check software, instruments, data folder and clock.",
        "token": "Create, list and revoke access tokens.",
        "notify": "Send test messages to notification receivers.",
        "completion": "Print the shell completion script for bash, zsh or fish.",
    },
    "control": {
        "pause": "Pause striking until resumed; due sets are missed.",
        "resume": "Resume a paused test with the next due set.",
        "disable": "Stop striking one transducer until it is enabled.",
        "enable": "Enable a disabled transducer from the next set.",
        "strike": "Take one unscheduled set at a transducer.",
        "approve-baseline": "Approve the proposed baseline of a transducer.",
        "renew-baseline": "Retire a baseline and collect a new one.",
        "trust-clock": "Trust the computer clock and continue the test.",
        "supply": "Switch the corrosion supply on or off.",
    },
    "monitor": {
        "status": "Show recorder, latest sets, diagnoses and active alarms.",
        "explain": "Recompute an alarm from stored waveforms; write its evidence.",
        "report": "Write a test report as one printable HTML page.",
        "acceptance-report": "Check a test against acceptance limits.",
    },
    "data": {
        "verify": "Check all stored data for corruption; change nothing.",
        "repair": "List safe repairs of corrupt data; --apply makes them.",
        "rebuild": "Rebuild a lost or corrupt catalogue from stored sets.",
        "backup": "Copy a test, even while it runs; repeat for new data only.",
        "export": "Export a test as HDF5, tables or waveforms.",
    },
    "offline": {
        "assess": "Assess feature tables (CSV, Parquet, NPY) like a running test.",
        "features": "Extract features and quality flags from waveform files.",
        "replay": "Reassess a stored test with other settings; list changes.",
    },
    "twin": {
        "simulate": "Simulate one shot on the twin, or sweep its parameters.",
        "reproduce": "Reproduce the paper's figures and tables; list deviations.",
    },
}
"""Summaries by section and command, in the order of ``solimon --help``."""


def section_of(name: str) -> str | None:
    """Return the section of a command; None if there is no such command."""
    return next((section for section, commands in SECTIONS.items() if name in commands), None)


def summary(name: str) -> str:
    """Return the summary of a command."""
    section = section_of(name)
    assert section is not None, f"{name} is not in the registry"
    return SECTIONS[section][name]
