"""``check-config``: describe a planned test."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from analysis.assessment.baseline_quality import GOOD_SETS
from analysis.statistics.rules import MINIMUM_SETS
from daq_service.acquisition.schedule import list_due_hours, plan_sets
from daq_service.cli.forecast import predict_confirmation_bytes, predict_record_sizes, predict_stored_bytes
from daq_service.clock import format_utc, parse_utc
from daq_service.errors import UsageError
from daq_service.processes.data_folder import choose_folder
from daq_service.processes.disk_policy import disk_usage
from daq_service.settings.file import load_settings
from daq_service.settings.notifications import NotificationSettings
from daq_service.settings.schema import build_schema_with_kinds
from daq_service.settings.tree import PositionSettings, Settings
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE


def print_configuration(*, config: Path | None, data_dir: Path | None, schema: bool, as_json: bool) -> None:
    """Run `solimon check-config`: validate the configuration and print the planned test.

    Warns of too few baseline sets, missing addresses and a disk that is too small. With ``schema`` it prints
    only the JSON schema. Raises UsageError for an invalid configuration.
    """
    if schema:
        click.echo(json.dumps(build_schema_with_kinds(), indent=1))
        return
    settings = load_settings(config)
    facts = describe_plan(settings, choose_folder(settings.storage, config, data_dir))
    if as_json:
        click.echo(json.dumps(facts))
        return
    click.echo(f"{settings.name}: the configuration is good ({settings.configuration_hash()[:12]})")
    click.echo(f"sets       {facts['sets']}, the last one due at hour {facts['last_due_h']:g}")
    _print_baseline(settings, facts)
    click.echo(f"strikes    {facts['strikes']} ({settings.schedule.shots_per_set} a set and transducer)")
    click.echo(f"echoes     {facts['pulse_echo_records']}")
    if facts["record_samples"] is not None:
        click.echo(
            f"record     {facts['record_samples']} samples at {facts['sample_rate_hz'] / 1e6:g} MS/s: "
            f"{facts['record_s'] * 1e3:.4g} ms"
        )
    click.echo(
        f"raw data   {facts['raw_bytes'] / 1e9:.2f} GB, about {facts['stored_bytes'] / 1e9:.2f} GB on disk, "
        f"and at most {facts['most_confirmation_bytes'] / 1e9:.2f} GB of confirmation sets"
    )
    click.echo(f"free disk  {facts['free_bytes'] / 1e9:.1f} GB at {facts['data_folder']}")
    click.echo(f"end        {facts['end_utc']} ({settings.clock.kind} clock)")
    _print_receivers(settings.notifications)
    for warning in find_calibration_warnings(settings.positions):
        click.echo(f"WARNING: {warning}; calibrate the sensor, then correct the date", err=True)
    if facts["stored_bytes"] > facts["free_bytes"]:
        click.echo(
            "WARNING: the disk is too small for this test; free space or choose another --data-dir", err=True
        )


def _print_baseline(settings: Settings, facts: dict[str, Any]) -> None:
    """Print the planned baseline sets; warn on standard error if they are too few or no set follows them.

    Prints nothing without transducers.
    """
    if not settings.list_positions(SOLITARY_WAVE):
        return
    n_sets, minimum = facts["baseline_sets"], max(settings.baseline.minimum_sets, MINIMUM_SETS)
    needs = f"it needs at least {minimum}, {GOOD_SETS} and more are advised"
    click.echo(f"baseline   {n_sets} sets planned for each transducer; {needs}")
    if n_sets < minimum or n_sets >= facts["sets"]:
        click.echo(
            f"WARNING: nothing would be judged: the plan has {facts['sets']} sets, and baseline.hours = "
            f"{settings.baseline.hours:g} takes {n_sets} of each transducer; {needs}, and sets behind it",
            err=True,
        )


def _print_receivers(notifications: NotificationSettings) -> None:
    """Print the receivers of alarms with secrets hidden; warn on stderr of addresses that cannot be read.

    Only a warning, since the service may run as another user.
    """
    from daq_service.processes.notifications.addresses import hide_address_secrets, read_address

    for name, receiver in notifications.receivers.items():
        click.echo(f"receiver   {name}: {receiver.kind}, {hide_address_secrets(receiver)}")
        try:
            read_address(name, receiver)
        except UsageError as error:
            click.echo(f"WARNING: {error}", err=True)


def find_calibration_warnings(positions: Mapping[str, PositionSettings]) -> list[str]:
    """Return a text for each sensor whose external calibration is overdue today (UTC)."""
    today = datetime.now(UTC).date()
    return [
        f"positions.{name}.calibration.due_on = {place.calibration.due_on} is over"
        for name, place in positions.items()
        if place.calibration.is_overdue(today)
    ]


def describe_plan(settings: Settings, folder: Path) -> dict[str, Any]:
    """Compute the numbers of a planned test for JSON: sets, records, hours, bytes planned and free.

    Record length and sampling rate are None if the instruments determine them; the last due hour and the end
    are None without sets. Builds one set in memory to estimate the size on disk.
    """
    start_ns = parse_utc(settings.clock.epoch) if settings.clock.kind == "simulated" else time.time_ns()
    planned = plan_sets(settings.schedule.phases, start_ns, end_h=settings.schedule.end_h)
    strikes = len(planned) * settings.schedule.shots_per_set * len(settings.list_positions(SOLITARY_WAVE))
    echoes = len(planned) * len(settings.list_positions(PULSE_ECHO))
    strike, echo = predict_record_sizes(settings)
    raw_bytes = strikes * strike.n_bytes + echoes * echo.n_bytes
    return {
        "name": settings.name,
        "configuration_hash": settings.configuration_hash(),
        "sets": len(planned),
        # Of the complete schedule, not limited by end_h, as the baseline counts them.
        "baseline_sets": len(list_due_hours(settings.schedule.phases, end_h=settings.baseline.hours)),
        "strikes": strikes,
        "pulse_echo_records": echoes,
        "record_samples": strike.samples if strike.known else None,
        "sample_rate_hz": strike.sample_rate_hz if strike.known else None,
        "record_s": strike.samples / strike.sample_rate_hz if strike.known else None,
        "raw_bytes": raw_bytes,
        "stored_bytes": predict_stored_bytes(settings, len(planned)),
        "most_confirmation_bytes": predict_confirmation_bytes(
            settings, planned[-1].due_h if planned else 0.0
        ),
        "free_bytes": disk_usage(folder)[0],
        "data_folder": str(folder),
        "last_due_h": planned[-1].due_h if planned else None,
        "end_utc": format_utc(planned[-1].due_utc_ns, 3) if planned else None,
    }
