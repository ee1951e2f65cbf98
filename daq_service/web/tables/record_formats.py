"""Files of waveforms: an array in volts with a row per record, and a column per fact (`records.OF_RECORD`).

============ ===========================================================================================
csv          a column a record, for spreadsheets: time, then ``set_3_shot_0_good_v``; it has no facts
parquet      a row a record; ``voltage_v`` is a list, the facts are in the schema's metadata
arrow        the same as an Arrow IPC stream
npz          ``time_s``, ``voltage_v`` (records, samples), the columns, and ``solimon``: facts as JSON text
mat          MATLAB 5: a struct ``waveforms`` of the same, a struct ``units``, and ``facts`` as JSON text
h5           NXdata ``voltage_v[sequence, time_s]``, which silx and H5Web plot
============ ===========================================================================================
"""

from __future__ import annotations

import csv
import io

import numpy as np
import orjson

from daq_service.archive.table_file import build_records_image
from daq_service.catalogue import Catalogue
from daq_service.processes.freshness import Freshness
from daq_service.web.tables import formats
from daq_service.web.tables.export import build_facts
from daq_service.web.tables.records import OF_RECORD, RecordChoice, RecordSlice

NAME = "waveforms"
UNITS = {"time_s": "s", "voltage_v": "V", **{column.name: column.unit for column in OF_RECORD if column.unit}}


def encode_records(
    catalogue: Catalogue, fresh: Freshness, choice: RecordChoice, records: RecordSlice, form: str
) -> bytes:
    """Encode waveforms as a complete file in one of `formats.FORMATS` (``form``), with facts except in CSV.

    Raises
    ------
    UsageError
        A package for the format is missing.
    """
    about = {
        "position": choice.position,
        **{name: getattr(choice, name) for name in ("from_h", "to_h", "first_set", "last_set")},
        "units": UNITS,
        "n_unreadable": records.columns["readable"].count(False),
    }
    facts = build_facts(catalogue.read_experiment(), fresh, about)
    if form == "csv":
        return _write_csv(records)
    if form in ("parquet", "arrow"):
        return _write_arrow(records, facts, form)
    arrays = {
        "time_s": records.time_s,
        "voltage_v": records.voltage_v,
        **{column.name: formats.to_array(column.form, records.columns[column.name]) for column in OF_RECORD},
    }
    if form == "npz":
        return formats.build_npz(arrays, facts)
    if form == "mat":
        return formats.build_mat(NAME, arrays, UNITS, facts)
    columns = {column.name: formats.convert_texts_for_h5py(arrays[column.name]) for column in OF_RECORD}
    return build_records_image(
        NAME,
        columns,
        records.time_s,
        records.voltage_v,
        axis="sequence",
        facts_text=formats.format_facts(facts),
    )


def _write_csv(records: RecordSlice) -> bytes:
    """Encode waveforms as CSV: time in s, then one column in V each; NaN is an empty cell."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    keys = zip(*(records.columns[name] for name in ("set_index", "shot_index", "quality")), strict=True)
    names = [f"set_{index}_shot_{shot}_{quality or 'unknown'}_v" for index, shot, quality in keys]
    writer.writerow(["time_s", *names])
    rows = np.ascontiguousarray(np.vstack([records.time_s, records.voltage_v]).T)
    # JSON has every digit, too, and takes a tenth of the time of `csv`; NaN, its null, is an empty cell.
    cells = orjson.dumps(rows, option=orjson.OPT_SERIALIZE_NUMPY).removeprefix(b"[[").removesuffix(b"]]")
    return text.getvalue().encode() + cells.replace(b"],[", b"\r\n").replace(b"null", b"") + b"\r\n"


def _write_arrow(records: RecordSlice, facts: formats.Facts, form: str) -> bytes:
    """Encode waveforms as ``parquet`` or ``arrow``, one row each; raise UsageError without pyarrow."""
    arrow = formats.import_pyarrow()
    n_samples = records.time_s.size
    volts = arrow.field("voltage_v", arrow.list_(arrow.float64(), n_samples), metadata={"unit": "V"})
    schema = arrow.schema(
        [*(formats.build_arrow_field(arrow, column) for column in OF_RECORD), volts],
        metadata={"solimon": formats.format_facts(facts)},
    )
    arrays = [
        *(formats.to_arrow(arrow, schema.field(c.name).type, records.columns[c.name]) for c in OF_RECORD),
        arrow.FixedSizeListArray.from_arrays(arrow.array(records.voltage_v.ravel()), n_samples),
    ]
    return b"".join(formats.encode_arrow(arrow, form, schema, [arrays]))
