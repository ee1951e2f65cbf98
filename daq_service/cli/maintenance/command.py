"""Run ``verify``, ``repair``, ``backup``, ``export`` and ``acceptance-report``."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq_service.errors import EXIT_OK, StorageError, UsageError
from daq_service.processes.data_folder import hold_recorder_lock, is_held
from daq_service.processes.printing import print_result

if TYPE_CHECKING:
    from daq_service.cli.maintenance.export_table import ExportedTable
    from daq_service.cli.maintenance.verify import Finding

PROGRESS_EVERY_S = 10.0
"""Interval of progress lines if standard error is not a terminal."""
LOWEST_PRIORITY = 19
OPTIONS_OF_EXPORT: Mapping[str, Collection[str]] = {
    "hdf5": (),
    "ro_crate": ("license", "author"),
    "table": ("out", "position", "from_h", "to_h", "fields", "purpose"),
    "waveforms": ("out", "from_h", "to_h", "first_set", "last_set"),
}


def run_verify(*, data_dir: Path, as_json: bool) -> int:
    """Run `solimon verify`: check a folder, print the findings, return 4 if something is corrupt, else 0.

    Nothing is written. Runs with low priority while a recorder owns the folder. Raises StorageError if the
    folder holds no test.
    """
    from daq_service.cli.maintenance.verify import verify_folder

    _lower_priority(data_dir)
    report = verify_folder(data_dir, _create_progress_printer("files"))
    damage = [asdict(finding) for finding in report.damage]
    counts = [f"{n} {name.replace('_', ' ')}" for name, n in report.checked.items() if name != "bytes"]
    lines = [
        *_format_findings(report.damage),
        *(f"note      {note}" for note in report.notes),
        f"checked   {', '.join(counts)}, {report.checked['bytes'] / 1e6:.1f} MB",
        f"damage    {len(damage)}, named above" if damage else "damage    none",
    ]
    result = {"ok": not damage, "checked": report.checked, "damage": damage}
    print_result(result, lines, as_json=as_json)
    return StorageError.exit_code if report.damage else EXIT_OK


def run_repair(*, data_dir: Path, apply: bool, backup: Path | None, as_json: bool) -> int:
    """Run `solimon repair`: print the steps, execute them if ``apply``; return 4 while corruption remains.

    Raises
    ------
    BusyError
        ``apply``, and a recorder owns the folder.
    StorageError
        The folder holds no test, or a step fails.
    """
    from daq_service.cli.maintenance.repair import execute_repair_step, plan_repair
    from daq_service.cli.maintenance.verify import verify_folder

    with hold_recorder_lock(data_dir) if apply else nullcontext():
        report = verify_folder(data_dir, _create_progress_printer("files"))
        steps = plan_repair(data_dir, report, backup)
        if apply:
            for step in steps:
                try:
                    execute_repair_step(data_dir, step, backup)
                except OSError as error:
                    raise StorageError(f"{step.file}: {error}; repair the disk and start again") from error
            report = verify_folder(data_dir, _create_progress_printer("files"))
    damage = [asdict(item) for item in report.damage]
    lines = [f"{step.does:<13} {step.file}: {step.reason}" for step in steps]
    if any(step.does != "nothing" for step in steps) and not apply:
        lines.append("nothing is done yet: --apply does it")
    result = {"ok": not damage, "applied": apply, "steps": list(map(asdict, steps)), "damage": damage}
    print_result(result, [*lines, f"damage left   {len(damage)}"], as_json=as_json)
    return StorageError.exit_code if report.damage else EXIT_OK


def run_backup(*, destination: Path, data_dir: Path, as_json: bool) -> int:
    """Run `solimon backup`: copy a folder; return 4 if a file in it is corrupt or a set is lost, else 0.

    Raises the errors of `backup.back_up`.
    """
    from daq_service.cli.maintenance.backup import back_up

    _lower_priority(data_dir)
    copied = back_up(data_dir, destination, _create_progress_printer("files"))
    line = (
        f"{destination}: {copied.files} files copied ({copied.n_bytes / 1e6:.1f} MB), "
        f"{copied.present} sets were there already"
    )
    result = {"ok": not copied.damage, "destination": str(destination), **asdict(copied)}
    print_result(result, [*_format_findings(copied.damage), line], as_json=as_json)
    return StorageError.exit_code if copied.damage else EXIT_OK


def run_export(
    *,
    data_dir: Path,
    hdf5: Path | None,
    ro_crate: Path | None,
    table: str | None,
    waveforms: str | None,
    targets: Sequence[Path],
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Run `solimon export`: write one file of a test, a folder for a repository, a table or waveforms.

    Returns 4 if a set's file is unreadable and therefore left out, otherwise 0. Raises UsageError unless
    exactly one kind is chosen with options that belong to it; otherwise the errors of the export functions.
    """
    kinds = {"hdf5": hdf5, "ro_crate": ro_crate, "table": table, "waveforms": waveforms}
    chosen = [name for name, value in kinds.items() if value is not None]
    if len(chosen) != 1:
        raise UsageError(
            "give --hdf5 FILE, --ro-crate FOLDER, --table NAME with --out FILE, or --waveforms POSITION with "
            "--out FILE"
        )
    given = {name: value for name, value in options.items() if value not in (None, ())}
    known = OPTIONS_OF_EXPORT[chosen[0]]
    if foreign := [name for name in [*given, *(["out"] if targets else [])] if name not in known]:
        sentence = ", ".join(f"--{name.replace('_', '-')}" for name in foreign)
        raise UsageError(f"{sentence} does not belong to --{chosen[0].replace('_', '-')}; leave it out")
    if "out" in known and not targets:
        raise UsageError(f"--{chosen[0]} needs --out FILE")
    if table is not None:
        from daq_service.cli.maintenance.export_table import export_table
        from daq_service.web.tables.choice import Choice

        choice = Choice(table=table, **given)
        return _print_files(export_table(data_dir, choice, targets, overwrite=overwrite), as_json=as_json)
    if waveforms is not None:
        from daq_service.cli.maintenance.export_table import export_records
        from daq_service.web.tables.records import RecordChoice

        records = RecordChoice(position=waveforms, **given)
        return _print_files(export_records(data_dir, records, targets, overwrite=overwrite), as_json=as_json)
    if ro_crate is not None:
        return _export_ro_crate(data_dir, ro_crate, overwrite=overwrite, as_json=as_json, **given)
    from daq_service.cli.maintenance.export import export_hdf5

    assert hdf5 is not None, "one of the kinds is given"
    file = export_hdf5(data_dir, hdf5, overwrite=overwrite, progress=_create_progress_printer("sets"))
    lines = [f"left out  {sentence}" for sentence in file.left_out.values()]
    if file.waiting:
        lines.append(f"waiting   {file.waiting} sets have no file yet; export again later")
    lines.append(f"{file.file}: {file.sets} sets, {file.shots} records ({file.n_bytes / 1e6:.1f} MB)")
    print_result({"ok": not file.left_out, **asdict(file)}, lines, as_json=as_json)
    return StorageError.exit_code if file.left_out else EXIT_OK


def _export_ro_crate(
    data_dir: Path,
    folder: Path,
    *,
    overwrite: bool,
    as_json: bool,
    license: str | None = None,  # noqa: A002 - the name of the option
    author: Sequence[str] = (),
) -> int:
    """Export a folder for a repository and print what it holds; return 4 if a set is left out, else 0."""
    from daq_service.cli.maintenance.ro_crate import REPORT, export_ro_crate

    crate = export_ro_crate(
        *(data_dir, folder),
        license_name=license,
        authors=author,
        overwrite=overwrite,
        progress=_create_progress_printer("sets"),
    )
    lines = [f"left out  {name}: {reason}" for name, reason in crate.left_out.items()]
    if license is None:
        lines.append("license   none; add one with --license before you publish the folder")
    lines.append(f"{folder}: {crate.sets} sets, {crate.files} files ({crate.n_bytes / 1e6:.1f} MB)")
    is_complete = not crate.left_out.keys() - {REPORT}
    print_result({"ok": is_complete, **asdict(crate)}, lines, as_json=as_json)
    return EXIT_OK if is_complete else StorageError.exit_code


def _print_files(files: Sequence[ExportedTable], *, as_json: bool) -> int:
    """Print path, table and size of each exported file, or JSON; return 0."""
    lines = [f"{item.file}: table {item.table} ({item.n_bytes / 1e6:.1f} MB)" for item in files]
    print_result({"ok": True, "files": list(map(asdict, files))}, lines, as_json=as_json)
    return EXIT_OK


def run_acceptance_report(*, data_dir: Path, **options: Any) -> int:
    """Run `solimon acceptance-report` with low priority; return 6 if the report does not pass, else 0.

    Raises the errors of `write_acceptance_report`.
    """
    from daq_service.cli.maintenance.acceptance.command import write_acceptance_report

    _lower_priority(data_dir)
    return write_acceptance_report(data_dir=data_dir, progress=_create_progress_printer("files"), **options)


def _format_findings(damage: Sequence[Finding]) -> list[str]:
    """Format each finding of corruption as a line: kind, file, description."""
    return [f"{finding.kind:<18} {finding.file}: {finding.description}" for finding in damage]


def _lower_priority(folder: Path) -> None:
    """Set the lowest scheduling priority for this process while a recorder runs on the folder.

    Does nothing on Windows. The priority is not restored.
    """
    if is_held(folder) and hasattr(os, "nice"):
        os.nice(LOWEST_PRIORITY)


def _create_progress_printer(what: str) -> Callable[[int, int], None]:
    """Create a function that prints how many of the planned ``what`` are done, to standard error."""
    terminal, printed_s = sys.stderr.isatty(), time.monotonic()

    def print_progress(done: int, planned: int) -> None:
        """Rewrite the progress line on a terminal; otherwise print a line every `PROGRESS_EVERY_S`."""
        nonlocal printed_s
        text, now_s = f"{done} of {planned} {what}", time.monotonic()
        if terminal:
            click.echo(f"\r{text} ", nl=done == planned, err=True)
        elif now_s - printed_s >= PROGRESS_EVERY_S:
            printed_s = now_s
            click.echo(text, err=True)

    return print_progress
