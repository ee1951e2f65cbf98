"""TDMS files as LabVIEW programs write them, for the tests of playback."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
from nptdms.timestamp import TdmsTimestamp

from hardware_drivers.measurement import PulseEchoRecord, Shot, Waveform

Properties = Mapping[str, Any]


def polynomial(coefficients, *, scale=0, source=None) -> dict[str, Any]:
    """Return scale number ``scale`` as DAQmx and LabVIEW write it."""
    prefix = f"NI_Scale[{scale}]_"
    properties: dict[str, Any] = {
        f"{prefix}Scale_Type": "Polynomial",
        f"{prefix}Polynomial_Coefficients_Size": len(coefficients),
        f"{prefix}Polynomial_Input_Source": 0xFFFFFFFF if source is None else source,
    }
    for index, value in enumerate(coefficients):
        properties[f"{prefix}Polynomial_Coefficients[{index}]"] = float(value)
    return properties


def time_stamp(utc_ns: int) -> TdmsTimestamp:
    """Convert nanoseconds of UTC to LabVIEW time: seconds since 1904 and 2^-64 of a second."""
    seconds, rest_ns = divmod(utc_ns, 1_000_000_000)
    return TdmsTimestamp(seconds + 2_082_844_800, (rest_ns << 64) // 1_000_000_000)


def waveform_properties(waveform: Waveform, utc_ns: int | None = None) -> dict[str, Any]:
    """Return the properties that LabVIEW writes for a waveform of volts."""
    return {
        "wf_increment": 1.0 / waveform.sample_rate_hz,
        "wf_start_offset": -waveform.pretrigger_samples / waveform.sample_rate_hz,
        "wf_samples": waveform.counts.size,
        "unit_string": "Volts",
        **({} if utc_ns is None else {"wf_start_time": time_stamp(utc_ns)}),
    }


def raw_properties(waveform: Waveform, utc_ns: int | None = None) -> dict[str, Any]:
    """Return the properties that DAQmx writes for unscaled codes."""
    return {
        **waveform_properties(waveform, utc_ns),
        "NI_Scaling_Status": "unscaled",
        "NI_Number_Of_Scales": 1,
        **polynomial(waveform.calibration.coefficients_v),
    }


def write(
    path: Path,
    channels: Iterable[tuple[str, str, Any, Properties]],
    *,
    groups: Mapping[str, Properties] | None = None,
    root: Properties | None = None,
) -> Path:
    """Write a file of channels: group, name, values, properties."""
    path.parent.mkdir(parents=True, exist_ok=True)
    objects: list[Any] = [RootObject(dict(root or {}))]
    objects += [GroupObject(name, dict(properties)) for name, properties in (groups or {}).items()]
    with TdmsWriter(path) as writer:
        writer.write_segment(objects)
        for group, name, values, properties in channels:
            writer.write_segment([ChannelObject(group, name, np.asarray(values), dict(properties))])
    return path


def write_set(folder: Path, set_index: int, records: Iterable[Shot | PulseEchoRecord]) -> Path:
    """Write a set in the default layout: file per set, group per position, channel per shot; raw codes."""
    return write(
        folder / f"set_{set_index:06d}.tdms",
        [
            (
                record.key.position,
                f"shot_{record.key.shot_index}",
                record.waveform.counts,
                raw_properties(record.waveform, record.stamp.utc_ns),
            )
            for record in records
        ],
    )
