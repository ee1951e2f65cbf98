"""Compare the test of a catalogue of any revision with the present settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, Table, inspect, select

from daq_service.catalogue.earlier_names import to_current_row
from daq_service.catalogue.errors import OtherExperimentError
from daq_service.catalogue.rows import ExperimentRow
from daq_service.catalogue.tables import events, experiment, features, thickness
from daq_service.settings.stored import list_settings_differences
from daq_service.settings.tree import Settings
from simulator.parameters.experiment import TWIN_VERSION


def raise_if_other_test(engine: Engine, path: Path, settings: Settings) -> None:
    """Raise an error if the test of a catalogue differs from the settings, an extractor or the twin.

    Returns without an error if the catalogue has no test yet; errors of SQL pass through.

    Raises
    ------
    OtherExperimentError
        Lists every key or version that differs with both values, and the remedy.
    """
    with engine.begin() as connection:
        # Columns that came later are missing in an earlier catalogue.
        found_names = {column["name"] for column in inspect(connection).get_columns(experiment.name)}
        columns = [experiment.c[name] for name in ExperimentRow.__slots__ if name in found_names]
        found = connection.execute(select(*columns)).one_or_none()
        if found is None:
            return  # no test yet
        lines = _describe_version_changes(connection, on_twin=settings.rig.on_twin)
    raise_if_other_configuration(
        ExperimentRow(**to_current_row("experiment", found._asdict())), path.parent, settings, lines
    )


def build_experiment_identity(row: ExperimentRow) -> str:
    """Build the identifier ``<configuration hash>/<hour 0 in ns UTC>`` of a test, to mark derived data."""
    return f"{row.configuration_hash}/{row.epoch_utc_ns}"


def raise_if_other_configuration(
    row: ExperimentRow, folder: Path, settings: Settings, lines: Sequence[str] = ()
) -> None:
    """Raise an error if an experiment has another configuration, or ``lines`` lists other differences.

    Returns without an error if configuration hashes agree and ``lines`` is empty.

    Raises
    ------
    OtherExperimentError
        Lists every key that differs with both values, the ``lines``, and the remedy.
    """
    own_hash = settings.configuration_hash()
    if row.configuration_hash != own_hash:
        lines = [*list_settings_differences(row.configuration, settings), *lines]
    if lines:
        raise OtherExperimentError(
            f"{folder} belongs to the test {row.name!r} with configuration "
            f"{row.configuration_hash}, not to configuration {own_hash}:\n"
            + "\n".join(f"  {line}" for line in lines)
            + "\nContinue with the configuration that started it (where a default, an extractor or the twin "
            f"has changed, with solimon {row.solimon_version}), or choose another folder with --data-dir."
        )


def _describe_version_changes(connection: Connection, *, on_twin: bool) -> list[str]:
    """List each extractor, and with ``on_twin`` the twin, whose version differs from that of the stored rows.

    Each line gives both versions; there is none if all agree. A version that was never stored is not
    compared.
    """
    # Loading the extractors takes a while, and only a folder that has a test needs it.
    from analysis.ultrasound import thickness as pulse_echo
    from analysis.waves import features as solitary_wave

    used = {
        "extractor of solitary waves": (_read_version(connection, features), solitary_wave.EXTRACTOR_VERSION),
        "extractor of pulse echoes": (_read_version(connection, thickness), pulse_echo.EXTRACTOR_VERSION),
    }
    if on_twin:
        used["physics of the twin"] = (_read_twin_version(connection), TWIN_VERSION)
    return [
        f"{name}: started with {began}, is {now} now"
        for name, (began, now) in used.items()
        if began not in (None, now)
    ]


def _read_version(connection: Connection, table: Table) -> Any:
    """Read the ``extractor_version`` of the newest row of a table; None if the table is empty."""
    return connection.execute(select(table.c.extractor_version).order_by(table.c.id.desc()).limit(1)).scalar()


def _read_twin_version(connection: Connection) -> object:
    """Read the twin version that the last recorder stored; "1" if it stored none, None without a recorder."""
    started = select(events.c.payload).where(events.c.kind == "recorder_started").order_by(events.c.id.desc())
    payload = connection.execute(started.limit(1)).scalar()
    return None if payload is None else payload.get("versions", {}).get("twin", "1")
