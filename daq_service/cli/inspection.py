"""``check-config``: describe a planned test, and find what would prevent it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import click

from analysis.assessment.baseline_quality import GOOD_SETS
from analysis.statistics.rules import MINIMUM_SETS
from analysis.waves.transducer import find_obstacles as find_chain_obstacles
from daq_service.acquisition.schedule import list_due_hours, plan_sets
from daq_service.acquisition.shot_features import derive_extraction_settings, describe_chain
from daq_service.catalogue import check_owner
from daq_service.catalogue.experiment_file import read_experiment_file
from daq_service.cli.forecast import predict_confirmation_bytes, predict_record_sizes, predict_stored_bytes
from daq_service.clock import WallClock, format_utc, parse_utc
from daq_service.errors import SolimonError, UsageError
from daq_service.processes.data_folder import choose_folder
from daq_service.processes.disk_policy import disk_space, disk_usage
from daq_service.rig import playback, twin
from daq_service.rig.open_rig import build_opening
from daq_service.settings.file import load_settings
from daq_service.settings.instruments import list_instruments
from daq_service.settings.notifications import NotificationSettings
from daq_service.settings.schema import build_schema_with_kinds
from daq_service.settings.tree import PositionSettings, Settings
from daq_service.web.auth.middleware import refuse_unprotected_service
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE


def print_configuration(*, config: Path | None, data_dir: Path | None, schema: bool, as_json: bool) -> None:
    """Run `solimon check-config`: validate the configuration, print the planned test, refuse what cannot run.

    Warns of too few baseline sets and missing addresses. With ``schema`` it prints only the JSON schema.

    Raises
    ------
    UsageError
        The configuration is invalid, or `find_obstacles` finds something: all of it.
    """
    if schema:
        click.echo(json.dumps(build_schema_with_kinds(), indent=1))
        return
    settings = load_settings(config)
    folder = choose_folder(settings.storage, config, data_dir)
    facts = describe_plan(settings, folder)
    if as_json:
        click.echo(json.dumps(facts))
    elif facts["sets"]:
        _print_plan(settings, facts)
    if obstacles := list(find_obstacles(settings, folder, facts)):
        raise UsageError("\n".join(["this test cannot run:", *(f"  {text}" for text in obstacles)]))
    if not as_json:
        click.echo(f"{settings.name}: the configuration is valid ({facts['configuration_hash'][:12]})")


def find_obstacles(settings: Settings, folder: Path, facts: Mapping[str, Any]) -> Iterator[str]:
    """Yield why the test would not run or assess nothing, each with value, limit and remedy.

    Opens recordings, but no other instrument. Writes nothing; a port in use is not found.

    Parameters
    ----------
    facts
        Numbers of the planned test (`describe_plan`).
    """
    first, n_baseline, n_sets = settings.schedule.phases[0], facts["baseline_sets"], facts["sets"]
    if not n_sets:
        end_h = settings.schedule.end_h or settings.schedule.phases[-1].until_h
        yield (
            f"schedule: no set is due up to hour {end_h:g}; the first interval is {first.interval_h:g} h. "
            "Shorten interval_h, or end the test later."
        )
    elif n_baseline >= n_sets and settings.list_positions(SOLITARY_WAVE):
        yield (
            f"baseline.hours = {settings.baseline.hours:g} takes {n_baseline} sets, and the schedule has "
            f"{n_sets}: no set would be assessed. Shorten the baseline, or end the test later."
        )
    space = disk_space(folder, settings.storage)
    available_bytes = max(0.0, space.free_bytes - space.stop_bytes)
    if facts["stored_bytes"] > available_bytes and read_experiment_file(folder) is None:
        yield (
            f"storage: the test needs {facts['stored_bytes'] / 1e9:.3g} GB, and {folder} has "
            f"{available_bytes / 1e9:.3g} GB until recording stops (storage.stop_free_fraction). "
            "Free disk space, or choose another --data-dir."
        )
    for check in (
        partial(_open_recordings, settings),
        partial(check_owner, settings, folder),
        partial(refuse_unprotected_service, settings.web, folder),
    ):
        try:
            check()
        except SolimonError as error:
            yield str(error)


def _open_recordings(settings: Settings) -> None:
    """Open each recording and close it; raise UsageError if one, or the twin, cannot be used here."""
    twin.require_twin(settings)
    for item in list_instruments(settings):
        if item.kind is playback.KIND:
            with item.kind.open(item.parameters, build_opening(item, settings, WallClock())):
                pass


def _print_plan(settings: Settings, facts: Mapping[str, Any]) -> None:
    """Print the planned test: sets, baseline, records, disk use, end, receivers; with their warnings."""
    click.echo(f"sets       {facts['sets']}, the last one due at hour {facts['last_due_h']:g}")
    _print_baseline(settings, facts)
    click.echo(f"strikes    {facts['strikes']} ({settings.schedule.shots_per_set} per set and transducer)")
    click.echo(f"echoes     {facts['pulse_echo_records']}")
    if facts["record_samples"] is not None:
        click.echo(
            f"waveform   {facts['record_samples']} samples at {facts['sample_rate_hz'] / 1e6:g} MS/s: "
            f"{facts['record_s'] * 1e3:.4g} ms"
        )
    click.echo(
        f"raw data   {facts['raw_bytes'] / 1e9:.2f} GB, about {facts['stored_bytes'] / 1e9:.2f} GB on disk, "
        f"and at most {facts['most_confirmation_bytes'] / 1e9:.2f} GB of confirmation sets"
    )
    click.echo(f"free disk  {facts['free_bytes'] / 1e9:.1f} GB at {facts['data_folder']}")
    click.echo(f"end        {facts['end_utc']} ({settings.clock.kind} clock)")
    _print_receivers(settings.notifications)
    strike = predict_record_sizes(settings)[0]
    for warning in find_transducer_warnings(settings.positions, strike.after_trigger_s):
        click.echo(f"WARNING: {warning}", err=True)
    for warning in find_calibration_warnings(settings.positions):
        click.echo(f"WARNING: {warning}; calibrate the sensor, then correct the date", err=True)


def _print_baseline(settings: Settings, facts: Mapping[str, Any]) -> None:
    """Print the planned baseline sets; warn on standard error if they are too few.

    Prints nothing without transducers.
    """
    if not settings.list_positions(SOLITARY_WAVE):
        return
    n_sets, minimum = facts["baseline_sets"], max(settings.baseline.minimum_sets, MINIMUM_SETS)
    needs = f"at least {minimum} are needed, {GOOD_SETS} or more are advised"
    click.echo(f"baseline   {n_sets} sets of each transducer; {needs}")
    if n_sets < minimum:
        click.echo(
            f"WARNING: no set would be assessed: baseline.hours = {settings.baseline.hours:g} takes "
            f"{n_sets} sets of each transducer; {needs}",
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


def find_transducer_warnings(positions: Mapping[str, PositionSettings], after_trigger_s: float) -> list[str]:
    """Return a text for each obstacle to assessing a transducer's waves, by Zener's model of the sound plate.

    ``after_trigger_s`` is the length of a record behind its trigger, infinite if unknown.
    """
    from simulator.zener.model import compute_reflection

    settings = derive_extraction_settings(positions)
    found = []
    for name, position in positions.items():
        if position.method == SOLITARY_WAVE:
            # The model knows equal spheres on a dry plate only, and these decide.
            plain = replace(position.chain, spheres=(), precompression_n=0.0)
            zener = compute_reflection(plain, replace(position.plate, liquid=None))
            found += [
                f"position {name}: {obstacle}"
                for obstacle in find_chain_obstacles(
                    describe_chain(position.chain),
                    settings[name],
                    inelasticity=zener.inelasticity,
                    amplitude_ratio=zener.amplitude_ratio,
                    after_trigger_s=after_trigger_s,
                )
            ]
    return found


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
