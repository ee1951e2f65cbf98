"""``solimon features``: extract features and flags of waveforms in files with the service's extractor."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

from analysis.errors import InvalidInputError, RecordError
from analysis.waves.features import (
    ALL_FEATURE_NAMES,
    EXTRACTOR_VERSION,
    ShotFeatures,
    apply_flags,
    extract_from_volts,
)
from analysis.waves.pulses import measure_first_fwhm_s
from analysis.waves.quality_gate import DISTURBED
from analysis.waves.record_reduction import FEWEST_BLOCKS, USUAL_FWHM_S, ExtractionSettings
from analysis.waves.template import Template, compare_with_others, learn_template
from daq_service.cli.offline.csv_lines import finite_or_none
from daq_service.cli.offline.record_file import FileParameters, Record, RecordFile, open_records
from daq_service.cli.sweep.progress import Progress
from daq_service.cli.terminal import create_console
from daq_service.errors import UsageError
from daq_service.settings.foreign_text import escape_to_one_line

MANY_RECORDS = 2_000
"""Number of records that take more than a second, so that progress is shown."""
LARGEST_V = 1e30
"""Larger values are not volts but an instrument's overload (9.9E37)."""
LOOKED_AT = 50
"""Number of evenly spread records that the width of waves is measured from."""

COLUMNS = (
    ("ToF us", "tof_mf_s", 1e6, 2),
    ("AR", "amplitude_ratio", 1.0, 4),
    ("ISW V", "isw_amplitude_v", 1.0, 4),
    ("ISW us", "isw_fwhm_s", 1e6, 1),
    ("noise V", "noise_rms_v", 1.0, 4),
)
"""Title, feature, factor to the unit and digits of the printed columns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TransducerParameters:
    """Given parameters of the transducer; None: learned from the records."""

    isw_fwhm_s: float | None = None
    isw_amplitude_v: float | None = None
    psw_window_s: tuple[float, float] | None = None


def run_features(
    *,
    files: tuple[Path, ...],
    rate_hz: float | None,
    pretrigger_s: float | None,
    volts_per_count: float | None,
    rail_counts: str | None,
    isw_fwhm_s: float | None,
    isw_amplitude_v: float | None,
    psw_window_s: str | None,
    as_json: bool,
) -> None:
    """Run `solimon features`: extract the features of each record of each file and print them.

    Prints a table or, with ``as_json``, JSON. Times are in s. Files that are refused are reported after the
    results.

    Raises
    ------
    UsageError
        An option is invalid; or, after the results, the error of the first refused file.
    """
    parameters = FileParameters(
        rate_hz=rate_hz,
        pretrigger_s=pretrigger_s,
        volts_per_count=volts_per_count,
        rails=_parse_increasing_pair("--rail-counts", "LOW,HIGH", rail_counts),
    )
    transducer = TransducerParameters(
        isw_fwhm_s=isw_fwhm_s,
        isw_amplitude_v=isw_amplitude_v,
        psw_window_s=_parse_increasing_pair("--psw-window-s", "FROM,TO", psw_window_s),
    )
    found: list[tuple[Path, list[ShotFeatures]]] = []
    refused: list[tuple[Path, UsageError]] = []
    for path in files:
        try:
            found.append((path, extract_file_features(path, parameters, transducer)))
        except UsageError as error:
            refused.append((path, error))
    if as_json:
        rows = [
            {"file": str(path), "index": index, **_shot_to_json(shot)}
            for path, shots in found
            for index, shot in enumerate(shots)
        ]
        refusals = [{"file": str(path), "reason": str(error)} for path, error in refused]
        answer = {"extractor_version": EXTRACTOR_VERSION, "records": rows, "refused": refusals}
        click.echo(json.dumps(answer, allow_nan=False))
    else:
        for path, shots in found:
            _print_features(path, shots)
    for _, further in refused[1:]:
        click.echo(f"solimon: {further}", err=True)
    if refused:
        raise refused[0][1]  # after the others' answers


def _parse_increasing_pair(option: str, form: str, text: str | None) -> tuple[float, float] | None:
    """Parse the text ``LOW,HIGH`` of an option to two increasing finite numbers; None stays None.

    Raises UsageError, which names the option, for any other text. ``form`` describes the text in messages.
    """
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
    except ValueError as error:
        raise UsageError(f"{option} is {text!r}; it must be {form}, two numbers") from error
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UsageError(f"{option} is {text!r}; it must be {form}, the first below the second")
    return low, high


def extract_file_features(
    path: Path, parameters: FileParameters, transducer: TransducerParameters
) -> list[ShotFeatures]:
    """Extract the features of a file's records, compared with their transducer's own waves, in file order.

    A record that cannot be searched for a wave, such as one that is too short, is flagged as disturbed. The
    templates and the number of inverted records are printed on standard error.

    Raises
    ------
    UsageError
        The file cannot be read, or no wave can be sought in any record.
    """
    file = open_records(path, parameters)
    settings = _build_extraction_settings(path, file, transducer)
    progress = Progress(file.n, 0, what="records") if file.n >= MANY_RECORDS else None
    shots, of_position = [], defaultdict(list)
    any_settings = next(iter(settings.values()))
    failed: list[UsageError] = []
    for index, record in enumerate(file.records(1)):
        try:
            own_settings = settings.get(record.position, any_settings)
            shots.append(_extract_record_features(f"{path}, record {index}", record, own_settings))
        except UsageError as error:
            failed.append(error)
            shots.append(apply_flags(ShotFeatures(), {DISTURBED}))  # shorter than the others of its file
        of_position[record.position].append(index)
        if progress is not None:
            progress.advance(1)
    if len(failed) == len(shots):
        raise failed[0]
    if inverted := sum("inverted" in shot.flags for shot in shots):
        click.echo(
            f"{path}: {inverted} of {len(shots)} records are inverted, their waves go down and have no "
            "features: reverse the sign of the values, or swap the PZT's leads",
            err=True,
        )
    for position, indices in of_position.items():
        width_s = settings.get(position, any_settings).isw_fwhm_s
        template = _combine_templates(
            transducer, learn_template([shots[index] for index in indices]), width_s
        )
        if template is not None:
            at = f"{path}{f', {position}' if position else ''}"
            click.echo(f"{at}: {_describe_template(template)}", err=True)
        found = compare_with_others([shots[index] for index in indices], template)
        for index, shot in zip(indices, found, strict=True):
            shots[index] = shot
    return shots


def _build_extraction_settings(
    path: Path, file: RecordFile, transducer: TransducerParameters
) -> dict[str, ExtractionSettings]:
    """Build the extraction settings by position: the given ISW width, or the median of measured ones.

    Widths are measured in about `LOOKED_AT` records; without a plausible one the default is used. Raises
    UsageError for invalid settings.
    """
    widths_s: dict[str, list[float]] = defaultdict(list)
    for record in file.records(-(-file.n // LOOKED_AT)):
        found = widths_s[record.position]
        if transducer.isw_fwhm_s is None:
            width_s = measure_first_fwhm_s(record.volts_v, record.rate_hz, record.pretrigger_samples)
            # That of a spike would refuse every record.
            narrowest_s = FEWEST_BLOCKS * max(ExtractionSettings().block_s, 1.0 / record.rate_hz)
            found.append(width_s if width_s >= narrowest_s else math.nan)
    given = dict(zip(("psw_earliest_s", "psw_latest_s"), transducer.psw_window_s or (), strict=False))
    settings = {}
    try:
        for position, found in widths_s.items():
            known = [width for width in found if width > 0.0]
            measured_s = float(np.median(known)) if known else USUAL_FWHM_S
            settings[position] = ExtractionSettings.for_width(transducer.isw_fwhm_s or measured_s, **given)
    except InvalidInputError as error:
        raise UsageError(f"{path}: {error}") from error
    return settings


def _extract_record_features(where: str, record: Record, settings: ExtractionSettings) -> ShotFeatures:
    """Extract the features of a record; flag missing values or values above `LARGEST_V` as disturbed.

    Raises UsageError, which names the record, if no wave can be sought in it.
    """
    if not (np.abs(record.volts_v) < LARGEST_V).all():
        return apply_flags(ShotFeatures(), {DISTURBED})  # samples are missing, or no volts
    try:
        return extract_from_volts(
            record.volts_v,
            record.rate_hz,
            record.pretrigger_samples,
            clipped=record.clipped,
            settings=settings,
            with_sd=True,
        )
    except RecordError as error:
        raise UsageError(
            f"{where}: {error} (--rate-hz, --pretrigger-s, --isw-fwhm-s describe it; "
            "a row of a table is a record, not a sample)"
        ) from error


def _combine_templates(
    transducer: TransducerParameters, found: Template | None, width_s: float
) -> Template | None:
    """Combine given and learned parameters of the template; given ones have priority.

    None if nothing was learned and no ISW amplitude (V) is given. ``width_s`` is the ISW width (s) if nothing
    was learned.
    """
    height_v = transducer.isw_amplitude_v
    if found is None:
        return None if height_v is None else Template(isw_fwhm_s=width_s, isw_amplitude_v=height_v)
    return replace(
        found,
        isw_fwhm_s=found.isw_fwhm_s if transducer.isw_fwhm_s is None else transducer.isw_fwhm_s,
        isw_amplitude_v=found.isw_amplitude_v if height_v is None else height_v,
    )


def _describe_template(template: Template) -> str:
    """Describe the template of the comparison: ISW width (us), height (V), earliest reflection (us)."""
    early = template.earliest_tof_s
    since = "" if early is None else f", reflections from {1e6 * early:.0f} us on"
    width_us, height_v = 1e6 * template.isw_fwhm_s, template.isw_amplitude_v
    return f"compared with an ISW {width_us:.1f} us wide and {height_v:.4g} V high{since}"


def _shot_to_json(shot: ShotFeatures) -> dict[str, object]:
    """Convert the features of a shot to a JSON object with flags and SDs; null for missing values."""
    return {
        "flags": list(shot.flags),
        "quality": shot.quality,
        **{name: finite_or_none(value) for name, value in shot.values().items()},
        "sd": {name: finite_or_none(shot.sd.get(name, math.nan)) for name in ALL_FEATURE_NAMES},
    }


def _print_features(path: Path, shots: Sequence[ShotFeatures]) -> None:
    """Print quality, flags and the features in `COLUMNS` of a file's records as a table on stdout."""
    from rich.table import Table

    table = Table(title=f"{escape_to_one_line(str(path))}, extractor {EXTRACTOR_VERSION}")
    for name in ("record", "quality", "flags", *(title for title, *_ in COLUMNS)):
        table.add_column(name, justify="left" if name in ("quality", "flags") else "right")
    for index, shot in enumerate(shots):
        values = shot.values()
        cells = [
            _format_with_sd(values[name], shot.sd.get(name, math.nan), factor, digits)
            for _, name, factor, digits in COLUMNS
        ]
        table.add_row(str(index), shot.quality, ", ".join(shot.flags) or "-", *cells)
    create_console("stdout").print(table)


def _format_with_sd(value: float, sd: float, factor: float, digits: int) -> str:
    """Format ``factor * value (factor * sd)``; "-" for a missing value, no parentheses for a missing SD.

    ``digits`` are decimals.
    """
    if not math.isfinite(value):
        return "-"
    text = f"{factor * value:.{digits}f}"
    return f"{text} ({factor * sd:.{digits}f})" if math.isfinite(sd) else text
