"""`/api/v1/sets/{position}/{set_index}/waveforms`: waveforms of a set, and their search windows."""

from __future__ import annotations

import numpy as np
from fastapi import APIRouter, Request
from starlette.responses import Response

from analysis.ultrasound.thickness import THICKEST_FRACTION, THINNEST_FRACTION
from analysis.waves.pulses import search_windows_s
from analysis.waves.quality_gate import ACCEPTED
from analysis.waves.record_reduction import ExtractionSettings
from daq_service.acquisition.shot_features import derive_extraction_settings
from daq_service.archive import SetNotFoundError, SetReference
from daq_service.assessment.methods import METHODS
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import FeatureRow, SetRow, ShotRow, ThicknessRow, WallRow
from daq_service.processes.installation import MissingExtraError
from daq_service.web.answers.json_answer import JsonAnswer, build_framed_body
from daq_service.web.answers.models import UNCHANGED, TwinWaveform, describe_errors, describe_files
from daq_service.web.answers.problem import Problem, not_found
from daq_service.web.answers.unchanged import check_etag
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import SetOfPath
from daq_service.web.routes.waveforms import OCTET_STREAM, to_little_endian_bytes
from hardware_drivers.measurement import SetKey
from hardware_drivers.methods import SOLITARY_WAVE

router = APIRouter(tags=["waveforms"])


@router.get(
    "/sets/{position}/{set_index}/waveforms",
    response_class=Response,
    responses=describe_files(OCTET_STREAM) | UNCHANGED | describe_errors(404, 503),
)
def get_set_waveforms(request: Request, context: ContextOf, position: str, set_index: SetOfPath) -> Response:
    """Return the accepted waveforms of a set: u32 header length, JSON header, then all samples.

    For each record the header has shot_index, sequence, dtype, n_samples, sample_rate_hz,
    pretrigger_samples and coefficients_v (volts = sum of coefficients_v[k] counts^k). It also has the
    windows in which pulses or echoes are searched, and counts unreadable records (n_damaged). Answered with
    404 if none is stored.
    """
    catalogue, key = context.catalogue(), SetKey.parse(set_index)._asdict()
    set_row = next(iter(catalogue.rows(SetRow, position=context.validate_position(position), **key)), None)
    accepted = {
        row.sequence for row in catalogue.rows(ShotRow, position=position, **key) if row.outcome == ACCEPTED
    }
    if set_row is None or set_row.file is None or not accepted:
        raise not_found(
            f"No record of position {position}, set {set_index} is stored.",
            "/api/v1/sets lists the sets, and why one is missed.",
        )
    headers: dict[str, str] = {}
    if set_row.file_sha256 is not None:
        headers, not_modified = check_etag(request, f'"{set_row.file_sha256[:20]}-{position}"')
        if not_modified is not None:
            return not_modified
    try:
        taken = context.archive.read_position_records(SetReference(set_row.file), position)
    except SetNotFoundError as error:
        raise not_found(str(error), "Look whether the file was moved out of the data folder.") from error
    records = [record for record in taken if record.sequence in accepted]
    header = {
        "position": position,
        **key,
        "method": set_row.method,
        "n_damaged": len(accepted) - len(records),
        "windows_s": _compute_windows_s(context, set_row),
        "records": [
            {
                "shot_index": record.key.shot_index,
                "sequence": record.sequence,
                "dtype": record.waveform.counts.dtype.name,
                "n_samples": int(record.waveform.counts.size),
                "sample_rate_hz": record.waveform.sample_rate_hz,
                "pretrigger_samples": record.waveform.pretrigger_samples,
                "coefficients_v": record.waveform.calibration.coefficients_v.tolist(),
            }
            for record in records
        ],
    }
    content = build_framed_body(header, *(to_little_endian_bytes(record.waveform) for record in records))
    return Response(content, media_type=OCTET_STREAM, headers=headers)


@router.get(
    "/sets/{position}/{set_index}/twin",
    response_model=TwinWaveform,
    responses={202: {"model": TwinWaveform}, **describe_errors(404, 501, 503)},
)
def get_twin_waveform(context: ContextOf, position: str, set_index: SetOfPath) -> JsonAnswer:
    """Return the simulated waveform on the samples of a set, at the newest wall thickness up to it.

    The plate is that of the most likely curve (`wall.curve`). Time and height of the incident wave are those
    of the set's mean, because the gain is unknown. 202: it is simulated, ask again; `voltage_v` is null. 404:
    no such wall or wave; 501 without the extra `twin`.
    """
    from analysis.errors import AnalysisError
    from simulator.errors import SimulatorError

    catalogue, key = context.catalogue(), SetKey.parse(set_index)._asdict()
    set_row = next(iter(catalogue.rows(SetRow, position=context.validate_position(position), **key)), None)
    mean = next(iter(catalogue.rows(FeatureRow, position=position, scope="set", **key)), None)
    walls = () if set_row is None else catalogue.rows(WallRow, position=position, last_h=set_row.due_h)
    wall = next((row for row in reversed(walls) if row.curve and row.thickness_m is not None), None)
    isw_time_s, isw_v = (None, None) if mean is None else (mean.isw_time_s, mean.isw_amplitude_v)
    if set_row is None or set_row.file is None or wall is None or isw_time_s is None or isw_v is None:
        raise not_found(
            f"Position {position} has no wall thickness from waves, or no incident wave, at set {set_index}.",
            "/api/v1/wall lists the thicknesses, from the end of the baseline on.",
        )
    place = context.settings.positions[position]
    loss = round(1.0 - (wall.thickness_m or 0.0) / place.plate.thickness_m, 3)
    extraction = derive_extraction_settings({position: place})[position]
    try:
        shot = context.twin_waveforms.find((place.chain, place.plate, extraction, wall.curve or "", loss))
        record = context.archive.read_waveform(SetReference(set_row.file), position, 0)
    except MissingExtraError as error:
        raise Problem("missing-extra", str(error)) from error
    except (AnalysisError, SimulatorError, SetNotFoundError) as error:
        raise not_found(f"No simulated waveform: {error}", "Choose another set.") from error
    time_s = (np.arange(record.counts.size) - record.pretrigger_samples) / record.sample_rate_hz
    fresh = context.read_freshness()
    answer = {
        "position": position,
        **key,
        "as_of": fresh.as_of(),
        "wall": fresh.row(wall),
        "sample_rate_hz": record.sample_rate_hz,
        "pretrigger_samples": record.pretrigger_samples,
        "voltage_v": None if shot is None else shot.to_volts(time_s, isw_time_s, isw_v).astype(np.float32),
        "reason": "the twin simulates it" if shot is None else None,
    }
    return JsonAnswer(answer, status_code=202 if shot is None else 200)


def _compute_windows_s(context: Context, set_row: SetRow) -> dict[str, tuple[float, float]]:
    """Return the search windows of a set by name of pulse or echo, as start and end in s from the trigger.

    Empty without a reference time (first pulse, or first thickness of the test).
    """
    catalogue, method = context.catalogue(), METHODS[set_row.method]
    filters: Filters = {"position": set_row.position, "set_index": set_row.set_index, **method.of_sets}
    filters["unscheduled_index"] = set_row.unscheduled_index
    result = next(iter(catalogue.rows(method.row, **filters)), None)
    if set_row.method == SOLITARY_WAVE:
        if not isinstance(result, FeatureRow) or result.isw_time_s is None:
            return {}
        positions = context.settings.positions
        settings = derive_extraction_settings(positions).get(set_row.position, ExtractionSettings())
        return search_windows_s(result.isw_time_s, result.psw_time_s, settings)
    # The reference echo of the test, as in the assessment.
    first = catalogue.read_first_thickness(set_row.position)
    delay_s = context.settings.ultrasound.delay_s
    if first is None or first.travel_time_s is None or first.travel_time_s <= delay_s:
        return {}
    span_s = first.travel_time_s - delay_s
    windows = {"first echo": (delay_s + THINNEST_FRACTION * span_s, delay_s + THICKEST_FRACTION * span_s)}
    if isinstance(result, ThicknessRow) and result.travel_time_s is not None:
        # The second echo has passed the wall twice; it is not measured, so only its expected time is shown.
        second_s = delay_s + 2.0 * (result.travel_time_s - delay_s)
        windows["second echo"] = (second_s, second_s)
    return windows
