"""``solimon doctor``: run the checks, print them, return the exit code."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import click
import orjson

from daq_service.cli.doctor.check import Check, build_error_check, build_finding_check, choose_exit_code
from daq_service.cli.doctor.machine import check_machine
from daq_service.cli.doctor.software import check_software
from daq_service.cli.doctor.storage import check_storage, lock_folder, read_lock_owner, refuse_if_owned
from daq_service.cli.doctor.trial import Trial, check_strike_position, strike_transducer
from daq_service.cli.inspection import find_calibration_warnings
from daq_service.clock import WallClock
from daq_service.processes.data_folder import DRIVE_LOCK, choose_folder, is_held
from daq_service.rig.open_rig import build_opening
from daq_service.settings.file import load_settings
from daq_service.settings.instruments import Instrument, list_instruments
from daq_service.settings.tree import PositionSettings, Settings
from hardware_drivers.errors import InstrumentError

Progress = Callable[[str], None]

KNOWN_AS = {"daqmx": "boards", "niscope": "ultrasonic probes", "climate": "climate probe"}
"""Display names of instruments with a table of their own."""


def run_doctor(*, config: Path | None, data_dir: Path | None, strike: str | None, as_json: bool) -> int:
    """Run `solimon doctor`: check computer, folder and instruments, and return the exit code.

    Prints a table, or JSON if ``as_json``. ``strike`` names a transducer to strike; it is not struck if a
    package is missing.

    Raises
    ------
    UsageError
        The configuration is invalid, or the position cannot be struck.
    BusyError
        A strike is requested while a recorder owns the folder.
    StorageUnavailableError
        The recorder's lock file in the folder cannot be opened.
    """
    settings = load_settings(config)
    folder = choose_folder(settings.storage, config, data_dir)
    if strike is not None:
        check_strike_position(settings, strike)
    owner = read_lock_owner(folder)
    if strike is not None:
        refuse_if_owned("--strike", owner)
    checks = list(run_checks(settings, folder, owner, _print_step))
    trial: Trial | None = None
    if strike is not None and any(check.area == "software" and check.state == "fail" for check in checks):
        found = "not struck: a package is missing"
        remedy = "install what failed above, then strike"
        checks.append(_build_skipped_check(f"strike {strike}: record", found, remedy))
    elif strike is not None:
        strikes = "two test strikes" if settings.rig.kind == "daqmx" else "one test strike"
        _print_step(f"{strikes} at {strike}")
        with lock_folder(folder) as owner:
            refuse_if_owned("--strike", owner)
            trial = strike_transducer(settings, strike)
        checks += trial.checks
    code = choose_exit_code(checks)
    if as_json:
        report = {
            "configuration_hash": settings.configuration_hash(),
            "rig": settings.rig.kind,
            "data_folder": str(folder),
            "exit_code": code,
            "checks": [asdict(check) for check in checks],
            "strike": None if trial is None else trial.as_row(),
        }
        click.echo(orjson.dumps(report, option=orjson.OPT_SERIALIZE_NUMPY))  # it writes NaN as null
    else:
        _print_checks(checks, trial)
    return code


def run_checks(settings: Settings, folder: Path, owner: str, progress: Progress) -> Iterator[Check]:
    """Yield all checks of computer, software, storage and instruments, but not the test strike.

    Writes only a probe file to the data folder.

    Parameters
    ----------
    owner
        Description of the recorder that owns the folder; its instruments are then reported as skipped. Empty:
        none.
    progress
        Called with the name of each step before it starts.
    """
    started_wall_s, started_mono_s = time.time(), time.monotonic()
    progress("packages")
    instruments = list_instruments(settings)
    needed = [name for item in instruments for name in item.kind.packages(item.parameters)]
    software = check_software(needed)
    yield from software
    progress(f"data folder {folder}")
    yield _check_recorder(owner)
    yield from check_storage(settings, folder)
    yield _check_calibrations(settings.positions)
    if owner:
        remedy = "stop the recorder first, or read `solimon status`"
        for name in (KNOWN_AS.get(item.name, item.name) for item in instruments):
            yield _build_skipped_check(name, "not checked: a recorder uses it", remedy)
    else:
        missing = {check.name for check in software if check.state == "fail"}
        yield from run_rig_checks(
            settings, instruments, missing, progress, driven=bool(is_held(folder, DRIVE_LOCK))
        )
    progress("clocks, sleep, updates and scanners")
    yield from check_machine(
        settings.clock.kind, folder, started_wall_s=started_wall_s, started_mono_s=started_mono_s
    )


def run_rig_checks(
    settings: Settings,
    instruments: Sequence[Instrument],
    missing: set[str],
    progress: Progress,
    *,
    driven: bool = False,
) -> Iterator[Check]:
    """Yield the checks of the instruments, without a strike and without switching an output.

    An instrument's error becomes a failed check.

    Parameters
    ----------
    missing
        Missing or outdated packages: instruments that need them are skipped.
    progress
        Called with a text before each instrument.
    driven
        Whether the supply process owns the supply's port; the supply is then skipped.
    """
    clock = WallClock()
    for item in instruments:
        name = KNOWN_AS.get(item.name, item.name)
        if set(item.kind.packages(item.parameters)) & missing:
            found = "not checked: a required package is missing"
            yield _build_skipped_check(name, found, "install what failed above, then run it again")
        elif driven and "supply" in item.serves:
            yield _build_skipped_check(name, "its own process has the port", "see `solimon status`")
        else:
            progress(f"{name}; nothing strikes, nothing is switched")
            instrument = item.name if settings.rig.kind == "mixed" else ""
            try:
                for finding in item.kind.check(item.parameters, build_opening(item, settings, clock)):
                    yield build_finding_check(finding, instrument)
            except InstrumentError as error:
                yield build_error_check(name, error, "see the manufacturer's manual")


def _build_skipped_check(name: str, found: str, remedy: str) -> Check:
    """Create a skipped check of area ``rig`` with the reason ``found`` and a remedy."""
    return Check("rig", name, "skipped", found, remedy)


def _check_recorder(owner: str) -> Check:
    """Return a passed check, or a failed one if ``owner`` describes a recorder that owns the folder.

    The text after the first ``; `` of ``owner`` is the remedy; without it, ValueError is raised.
    """
    name = "recorder"
    if not owner:
        return Check("recorder", name, "ok", "no recorder owns the data folder")
    problem, _, remedy = owner.partition("; ")
    return Check("recorder", name, "fail", problem, remedy)


def _check_calibrations(positions: Mapping[str, PositionSettings]) -> Check:
    """Warn of sensors whose external calibration is overdue."""
    warnings = find_calibration_warnings(positions)
    found = "; ".join(warnings) or "no external calibration is overdue"
    remedy = "calibrate the sensor, then correct the date"
    return Check("rig", "sensors: calibration", "warn" if warnings else "ok", found, remedy)


# What a person or a program reads --------------------------------------------------------------------


def _print_step(text: str) -> None:
    """Print the name of the step that starts, to standard error."""
    click.echo(f"checking: {text}", err=True)


def _print_checks(checks: list[Check], trial: Trial | None) -> None:
    """Print checks with remedies, features of the test strike, and counts per state, to standard output."""
    width = max(len(check.name) for check in checks)
    for check in checks:
        state = check.state.upper() if check.state in ("warn", "fail") else check.state
        click.echo(f"{state:<8} {check.name:<{width}}  {check.found}")
        if check.remedy:
            click.echo(f"{'':<8} {'':<{width}}  -> {check.remedy}")
    if trial is not None and trial.features is not None:
        for name, value in trial.as_row()["features"].items():
            text = f"{value:.6g}" if isinstance(value, float) else value
            click.echo(f"{'':<8} {name:<{width}}  {text}")
    counts = Counter(check.state for check in checks)
    click.echo(", ".join(f"{counts[state]} {state}" for state in ("fail", "warn", "ok", "skipped")))
