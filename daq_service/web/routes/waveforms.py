"""`/api/v1/waveforms`: stored waveforms in volts, and live figures by GET and WebSocket."""

from __future__ import annotations

import asyncio
import io
import itertools
import time
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Request, WebSocket, WebSocketDisconnect
from numpy.typing import NDArray
from starlette.responses import Response

from analysis.waves.quality_gate import ACCEPTED
from daq_service.archive import SetNotFoundError, SetReference
from daq_service.assessment.methods import METHODS
from daq_service.catalogue.rows import FeatureRow, SetRow, ShotRow, ThicknessRow
from daq_service.shared_file import read_shared
from daq_service.web.answers.json_answer import JsonAnswer, add_utc, format_rfc3339
from daq_service.web.answers.models import UNCHANGED, WaveformAnswer, describe_errors, describe_files
from daq_service.web.answers.problem import not_found
from daq_service.web.answers.unchanged import check_etag
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.admission import PersonOf
from daq_service.web.routes.listing import Index, SetOfPath
from daq_service.web.streams.live_figures import Picture, create_unreadable_figure, decode_figure_header
from hardware_drivers.measurement import SetKey, Waveform

router = APIRouter(tags=["waveforms"])
OCTET_STREAM = "application/octet-stream"
NPY = "application/x-npy"
MOST_POINTS = 100_000
LOOK_AT_TOKEN_S = 5.0
"""Interval of checks of the token, also without a new figure."""
ERRORS = describe_errors(404, 503)


@router.get(
    "/waveforms/live/{position}",
    response_class=Response,
    responses=describe_files(OCTET_STREAM) | ERRORS,
)
def get_live_waveform(position: str, context: ContextOf) -> Response:
    """Return the live figure: u32 header length, JSON header (volts = sum c[k] counts^k), samples.

    X-Sequence and X-Written are its number and time. Answered with 404 before the first record, and with 503
    if the file is damaged.
    """
    path = context.data_folder / "live" / f"{context.validate_position(position)}.bin"
    try:
        content = read_shared(path)
    except FileNotFoundError:
        raise not_found(
            f"Position {position} has no live waveform yet.", "The recorder writes one with its next record."
        ) from None
    except OSError as error:
        raise create_unreadable_figure(str(error)) from None
    header = decode_figure_header(content)
    return Response(
        content,
        media_type=OCTET_STREAM,
        headers={
            "X-Sequence": str(header["sequence"]),
            "X-Written": format_rfc3339(header["written_wall_utc_ns"]) or "",
        },
    )


@router.get(
    "/waveforms/{position}/{set_index}/{shot_index}",
    response_model=WaveformAnswer,
    responses=describe_files(NPY, OCTET_STREAM) | UNCHANGED | ERRORS,
)
def get_waveform(
    request: Request,
    context: ContextOf,
    position: str,
    set_index: SetOfPath,
    shot_index: Index,
    form: Annotated[Literal["json", "npy", "octets"], Query(alias="format")] = "json",
    points: Annotated[int | None, Query(ge=4, le=MOST_POINTS)] = None,
) -> Response:
    """Return one stored waveform, the accepted one of a repeated shot; pulse echo has shot index 0.

    With `points`, JSON and npy (rows: time in s, volts) hold only the extremes of equal bins, at most so
    many samples. Octets are all counts, with sampling and calibration in the headers.
    """
    context.validate_position(position)
    catalogue, set_key = context.catalogue(), SetKey.parse(set_index)
    shots = catalogue.rows(ShotRow, position=position, **set_key._asdict())
    row = next((shot for shot in shots if shot.shot_index == shot_index and shot.outcome == ACCEPTED), None)
    set_row = next(iter(catalogue.rows(SetRow, position=position, **set_key._asdict())), None)
    if row is None or set_row is None or set_row.file is None:
        raise not_found(
            f"Shot {shot_index} of position {position}, set {set_index} is not stored.",
            f"/api/v1/sets/{position}/{set_index}/shots lists the shots of a set.",
        )
    headers: dict[str, str] = {}
    if form != "json" and set_row.file_sha256 is not None:  # JSON also has the age
        etag = f'"{set_row.file_sha256[:20]}-{position}-{shot_index}-{form}-{points}"'
        headers, not_modified = check_etag(request, etag)
        if not_modified is not None:
            return not_modified
    try:
        waveform = context.archive.read_waveform(SetReference(set_row.file), position, shot_index)
    except SetNotFoundError as error:
        raise not_found(str(error), "Look whether the file was moved out of the data folder.") from error
    disposition = f'attachment; filename="{position}_{set_index.zfill(6)}_{shot_index:03d}'
    if form == "octets":
        return Response(
            to_little_endian_bytes(waveform),
            media_type=OCTET_STREAM,
            headers={
                **headers,
                "Content-Disposition": disposition + '.bin"',
                "X-Dtype": waveform.counts.dtype.name,
                "X-Sample-Rate-Hz": repr(waveform.sample_rate_hz),
                "X-Pretrigger-Samples": str(waveform.pretrigger_samples),
                "X-Coefficients-V": ",".join(repr(c) for c in waveform.calibration.coefficients_v.tolist()),
            },
        )
    time_s, voltage_v = waveform.time_s(), waveform.volts()
    if points is not None and points < time_s.size:
        indices = find_extremes_per_bin(voltage_v, points)
        time_s, voltage_v = time_s[indices], voltage_v[indices]
    if form == "npy":
        buffer = io.BytesIO()
        np.save(buffer, np.stack([time_s, voltage_v]))
        headers["Content-Disposition"] = disposition + '.npy"'
        return Response(buffer.getvalue(), media_type=NPY, headers=headers)
    fresh = context.read_freshness()
    quality = _find_quality(context, position, set_key, row.sequence)
    due = add_utc({"due_h": set_row.due_h}, fresh.epoch_utc_ns)
    return JsonAnswer(
        {
            "position": position,
            "method": set_row.method,
            **set_key._asdict(),
            "shot_index": shot_index,
            "sequence": row.sequence,
            "utc": format_rfc3339(row.utc_ns),
            **due,
            "valid": row.valid,
            "flags": row.flags,
            "quality": quality,
            "sample_rate_hz": waveform.sample_rate_hz,
            "pretrigger_samples": waveform.pretrigger_samples,
            "n_samples": int(waveform.counts.size),
            "downsampled": time_s.size < waveform.counts.size,
            "time_s": np.ascontiguousarray(time_s),
            "voltage_v": np.ascontiguousarray(voltage_v),
            "as_of": fresh.as_of(),
            "age_h": fresh.age_h(set_row.due_h),
        }
    )


def to_little_endian_bytes(waveform: Waveform) -> bytes:
    """Return the counts of a waveform as little-endian bytes of their own integer type."""
    return waveform.counts.astype(waveform.counts.dtype.newbyteorder("<"), copy=False).tobytes()


def find_extremes_per_bin(values: NDArray[np.float64], points: int) -> NDArray[np.intp]:
    """Find the indices of minimum and maximum of each of ``points // 2`` equal bins, in ascending order.

    No peak is lost: a chart with one pixel per bin looks the same as with all samples.

    Returns
    -------
    ndarray of intp, shape (m,), m <= points
        Strictly increasing; a bin whose extremes coincide gives one index.
    """
    edges = np.linspace(0, values.size, points // 2 + 1).astype(np.intp)
    indices = [
        start + extreme
        for start, stop in itertools.pairwise(edges.tolist())
        if stop > start
        for extreme in (int(values[start:stop].argmin()), int(values[start:stop].argmax()))
    ]
    return np.unique(np.asarray(indices, dtype=np.intp))


def _find_quality(context: Context, position: str, set_key: SetKey, sequence: int) -> str | None:
    """Return the quality of a record from its features or thickness; None without a result.

    ``sequence`` is the number of the record in the test.
    """
    kind: type[FeatureRow] | type[ThicknessRow] = METHODS[context.settings.positions[position].method].row
    rows = context.catalogue().rows(kind, position=position, **set_key._asdict())
    return next((row.quality for row in rows if row.sequence == sequence), None)


@router.websocket("/waveforms/live")
async def live_waveforms(
    websocket: WebSocket,
    context: ContextOf,
    person: PersonOf,
    positions: Annotated[str | None, Query(max_length=400)] = None,
) -> None:
    """Send the newest figure of each selected position (`positions=B,C`; absent: all) when it changes.

    Each binary message is one live file's bytes; a text message is a heartbeat (``interval_s``), sent where
    none comes. Only the newest is sent: a slow client misses figures. The guard has checked the Origin
    before. Unknown positions close the connection with code 1008, an invalid token or the end of the
    service with 1001.
    """
    known = context.settings.positions
    chosen = list(known) if positions is None else [part.strip() for part in positions.split(",")]
    if not chosen or any(name not in known for name in chosen):
        await websocket.close(code=1008, reason=f"positions must be among {', '.join(known)}"[:120])
        return
    await websocket.accept()
    live = context.live
    live.clients += 1
    left = asyncio.create_task(_wait_for_disconnect(websocket))
    seen = dict.fromkeys(chosen, 0)
    beat_s, sent_s = context.hub.heartbeat_interval_s, time.monotonic()
    try:
        while not left.done() and not live.closed and context.access_policy.has_access(person):
            newer: dict[str, Picture] = live.find_newer_figures(seen)
            for position, picture in newer.items():
                seen[position], sent_s = picture.version, time.monotonic()
                await websocket.send_bytes(picture.content)
            if not newer:
                changed = asyncio.ensure_future(live.changed())
                await asyncio.wait(
                    {changed, left},
                    timeout=min(LOOK_AT_TOKEN_S, beat_s),
                    return_when=asyncio.FIRST_COMPLETED,
                )
                changed.cancel()
                if time.monotonic() - sent_s >= beat_s and not left.done():
                    sent_s = time.monotonic()
                    await websocket.send_json({"interval_s": beat_s})
        if not left.done():
            await websocket.close(code=1001, reason="the service stops, or the token is no longer valid")
    except WebSocketDisconnect:
        return
    finally:
        live.clients -= 1
        left.cancel()


async def _wait_for_disconnect(websocket: WebSocket) -> None:
    """Discard the messages of a client; return when it disconnects."""
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass
