"""`/api/v1/files`: finished files of sets, complete or a range of their bytes."""

from __future__ import annotations

import re
from typing import Annotated

from fastapi import APIRouter, Path, Request
from starlette.responses import FileResponse, Response

from daq_service.catalogue.rows import SetRow
from daq_service.web.answers.models import describe_errors, describe_files
from daq_service.web.answers.problem import Problem, not_found
from daq_service.web.answers.unchanged import check_etag
from daq_service.web.context import Context, ContextOf
from hardware_drivers.measurement import SetKey

router = APIRouter(tags=["files"])
HDF5 = "application/x-hdf5"
NAME = re.compile(r"set_(\d{1,9})_\w+\.h5", re.ASCII)
RANGE = re.compile(r"bytes=(\d{0,18})-(\d{0,18})", re.ASCII)


@router.head("/files/{name}", include_in_schema=False)
@router.get(
    "/files/{name}",
    response_class=Response,
    responses=describe_files(HDF5)
    | {206: describe_files(HDF5)[200] | {"description": "The range that was asked for."}}
    | {304: {"description": "The client's copy, named by If-None-Match, is the file."}}
    | describe_errors(404, 416, 503),
)
def get_file(
    request: Request,
    context: ContextOf,
    name: Annotated[str, Path(max_length=80, description="As `sets` names it, without its folder")],
) -> Response:
    """Send the finished file of a set, or ranges of its bytes; it never changes.

    Answered with 404 while the set is only in the journal, with 304 if the client has it (ETag), and with 416
    for a range outside of the file.
    """
    row = _find_set_of_file(context, name)
    path = None if row is None or row.file is None else context.data_folder / row.file
    # A link may lead out of the data folder: it is not followed.
    if row is None or path is None or path.is_symlink() or not path.is_file():
        raise not_found(
            f"There is no finished file {name!r}.",
            "/api/v1/sets names the files; the newest sets get theirs a moment later.",
        )
    size = path.stat()
    # With compression, a range would refer to other bytes; the data in the file are already compressed.
    headers = {"Content-Encoding": "identity"}
    if row.file_sha256 is not None:
        cache_headers, not_modified = check_etag(request, f'"{row.file_sha256}"')
        if not_modified is not None:
            return not_modified
        headers |= cache_headers
    response = FileResponse(path, headers=headers, media_type=HDF5, filename=name, stat_result=size)
    byte_range, only_if = request.headers.get("range"), request.headers.get("if-range")
    if byte_range is not None and only_if in (None, response.headers["etag"]):
        _check_byte_range(byte_range, size.st_size)
    return response


def _find_set_of_file(context: Context, name: str) -> SetRow | None:
    """Find the set of a file name in the catalogue, so that no path comes from the request.

    None if no set has such a file.
    """
    match = NAME.fullmatch(name)
    if match is None:
        return None
    catalogue, index = context.catalogue(), SetKey.from_number(int(match[1])).set_index
    rows = (
        row
        for position in context.settings.positions
        for row in catalogue.rows(SetRow, position=position, set_index=index, purpose="any")
    )
    return next((row for row in rows if row.file is not None and row.file.rpartition("/")[2] == name), None)


def _check_byte_range(byte_range: str, n_bytes: int) -> None:
    """Raise a Problem (416) unless the header names one byte range that the file has at least in part.

    ``byte_range`` is the header Range; ``n_bytes`` is the size of the file.
    """
    match = RANGE.fullmatch(byte_range.replace(" ", ""))
    first, last = match.groups() if match else ("", "")
    is_valid = int(last or 0) > 0 if not first else int(first) < n_bytes and int(first) <= int(last or first)
    if not is_valid:
        raise Problem("range-not-satisfiable", f"Range is {byte_range[:60]!r}; the file has {n_bytes} bytes.")
