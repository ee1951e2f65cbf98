"""``check-config`` and ``status``: what a test will do, and how it stands."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from daq_service.acquisition.schedule import plan
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import AlarmRow, values
from daq_service.cli.forecast import record_sizes, stored_bytes
from daq_service.clock import format_utc, parse_utc
from daq_service.corrosion_drive.kept import described, look_at_drive
from daq_service.processes.data_folder import data_folder, settings_of_folder
from daq_service.processes.disk_policy import disk_usage, outlook
from daq_service.processes.heartbeat import time_now_ns
from daq_service.processes.lost_sets import lost_sets
from daq_service.processes.recorder_state import TELLING, look_at_recorder
from daq_service.settings.file import load_settings, settings_schema
from daq_service.settings.tree import Settings
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_S

SIZED = 1000
"""``status`` looks whether so many of the newest sets are empty; ``doctor`` and a recorder look at all."""


def print_configuration(*, config: Path | None, data_dir: Path | None, schema: bool, as_json: bool) -> None:
    """Carry out ``check-config``."""
    if schema:
        click.echo(json.dumps(settings_schema(), indent=1))
        return
    settings = load_settings(config)
    facts = describe_plan(settings, data_folder(settings, config, data_dir))
    if as_json:
        click.echo(json.dumps(facts))
        return
    click.echo(f"{settings.name}: the configuration is good ({settings.configuration_hash()[:12]})")
    click.echo(f"sets       {facts['sets']}, the last one due at hour {facts['last_due_h']:g}")
    click.echo(f"strikes    {facts['strikes']} ({settings.schedule.shots_per_set} a set and transducer)")
    click.echo(f"echoes     {facts['pulse_echo_records']}")
    if facts["record_samples"] is not None:
        click.echo(
            f"record     {facts['record_samples']} samples at {facts['sample_rate_hz'] / 1e6:g} MS/s: "
            f"{facts['record_s'] * 1e3:.4g} ms"
        )
    click.echo(
        f"raw data   {facts['raw_bytes'] / 1e9:.2f} GB, about {facts['stored_bytes'] / 1e9:.2f} GB on disk"
    )
    click.echo(f"free disk  {facts['free_bytes'] / 1e9:.1f} GB at {facts['data_folder']}")
    click.echo(f"end        {facts['end_utc']} ({settings.clock.kind} clock)")
    if facts["stored_bytes"] > facts["free_bytes"]:
        click.echo(
            "WARNING: the disk is too small for this test; free space or choose another --data-dir", err=True
        )


def describe_plan(settings: Settings, folder: Path) -> dict[str, Any]:
    """Numbers of a planned test."""
    start_ns = parse_utc(settings.clock.epoch) if settings.clock.kind == "simulated" else time.time_ns()
    planned = plan(settings.schedule.phases, start_ns, end_h=settings.schedule.end_h)
    strikes = len(planned) * settings.schedule.shots_per_set * len(settings.names_of(SOLITARY_WAVE))
    echoes = len(planned) * len(settings.names_of(PULSE_ECHO))
    strike, echo = record_sizes(settings)
    raw_bytes = strikes * strike.n_bytes + echoes * echo.n_bytes
    return {
        "name": settings.name,
        "configuration_hash": settings.configuration_hash(),
        "sets": len(planned),
        "strikes": strikes,
        "pulse_echo_records": echoes,
        "record_samples": strike.samples if strike.known else None,
        "sample_rate_hz": strike.sample_rate_hz if strike.known else None,
        "record_s": strike.samples / strike.sample_rate_hz if strike.known else None,
        "raw_bytes": raw_bytes,
        "stored_bytes": stored_bytes(settings, len(planned)),
        "free_bytes": disk_usage(folder)[0],
        "data_folder": str(folder),
        "last_due_h": planned[-1].due_h if planned else None,
        "end_utc": format_utc(planned[-1].due_utc_ns, 3) if planned else None,
    }


def print_status(*, config: Path | None, data_dir: Path | None, as_json: bool) -> None:
    """Carry out ``status``."""
    settings, folder = settings_of_folder(config, data_dir)
    facts = describe_status(folder, settings)
    if as_json:
        click.echo(json.dumps(facts))
        return
    click.echo(f"data      {folder}")
    click.echo(f"recorder  {facts['recorder']}")
    ahead_s = facts["system_ahead_s"]
    if ahead_s is not None and abs(ahead_s) > 1.0:
        side = "ahead of" if ahead_s > 0.0 else "behind"
        click.echo(f"clock     this computer's is {abs(ahead_s):.0f} s {side} the test's time")
    if facts["supply"] is not None:
        click.echo(f"supply    {facts['supply']['description']}")
    if facts["held"]:
        click.echo(f"on hold   {facts['held']}; nothing strikes until it is released")
    if facts["counts"] is None:
        click.echo("no data yet")
        return
    click.echo(f"sets      {facts['counts']['sets']}, {facts['counts']['missed_sets']} missed")
    for file, told in facts["lost"].items():
        click.echo(f"LOST      {file} {told}; solimon repair --from BACKUP brings it back")
    click.echo(f"disk      {_told_of_the_disk(facts['disk'])}")
    for name, row in facts["positions"].items():
        click.echo(f"{name:<9} {json.dumps(row)}")


def _told_of_the_disk(disk: dict[str, Any]) -> str:
    level = {"ample": "", "stop": "; nothing more is stored until some is freed"}.get(disk["level"], "; low")
    needed = disk["needed_bytes"]
    rest = "" if needed is None else f", about {needed / 1e9:.2f} GB still to come"
    full = "" if disk["full_at_h"] is None else f": full at hour {disk['full_at_h']:g}"
    return f"{disk['free_bytes'] / 1e9:.2f} GB free{level}{rest}{full}"


def describe_status(folder: Path, settings: Settings) -> dict[str, Any]:
    """Read the recorder's state, the counts, the disk, and the last word on each position."""
    drive = look_at_drive(folder)
    supply = None if drive is None else {**asdict(drive), "description": described(drive)}
    try:
        with open_catalogue(folder, writer=False) as catalogue:
            told = catalogue.last_told(*TELLING)
            recorder = look_at_recorder(folder, [told.kind] if told else [])
            now_ns = time_now_ns(recorder.beat)
            return {
                "recorder": recorder.description,
                "system_ahead_s": None if now_ns is None else (time.time_ns() - now_ns) / NS_PER_S,
                "supply": supply,
                "held": catalogue.held(),
                "counts": catalogue.counts(),
                "lost": lost_sets(folder, catalogue, newest=SIZED),
                "disk": asdict(outlook(folder, settings, catalogue)),
                "positions": {name: asdict(word) for name, word in catalogue.positions_state().items()},
                "alarms": [values(row) for row in catalogue.rows(AlarmRow, active=True)],
            }
    except NoDataYetError:
        nothing: dict[str, Any] = {"held": None, "counts": None, "positions": {}, "alarms": []}
        nothing |= {"disk": None, "lost": {}}
        recorder = look_at_recorder(folder, [])
        clock: dict[str, Any] = {"system_ahead_s": None}
        return {"recorder": recorder.description, **clock, "supply": supply, **nothing}
