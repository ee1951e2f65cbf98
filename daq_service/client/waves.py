"""Stored waveforms as an array in volts, with coordinates for each."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import pandas as pd
import xarray

from daq_service.client.connection import RETRY_S, Connection, Json
from daq_service.client.errors import ClientError

PER_SHOT = ("set_index", "unscheduled_index", "shot_index", "sequence", "valid")


def read_twin_waveform(connection: Connection, position: str, index: int | str) -> xarray.DataArray:
    """Read the simulated waveform of a set; wait until the service has simulated it.

    Raise RefusedError or UnreachableError as `Connection.get`.
    """
    while (answer := connection.get(f"sets/{position}/{index}/twin"))["voltage_v"] is None:
        connection.wait(RETRY_S)
    voltage_v = np.array(answer["voltage_v"])
    time_s = (np.arange(voltage_v.size) - answer["pretrigger_samples"]) / answer["sample_rate_hz"]
    wall = {name: answer["wall"][name] for name in ("curve", "thickness_m", "due_h", "quality")}
    return xarray.DataArray(
        voltage_v,
        dims=("time",),
        name="voltage",
        attrs={"units": "V", "position": position, "simulated": True, **wall},
        coords={"time": ("time", time_s, {"units": "s", "description": "from the trigger"})},
    )


def read_waveforms(
    connection: Connection, position: str, method: str, indices: Sequence[int | str]
) -> xarray.DataArray:
    """Read the accepted waveforms of sets in volts, with one request per shot; see `Experiment.waveforms`.

    Parameters
    ----------
    indices
        Set indices, or ``"12.1"`` for an unscheduled set.

    Returns
    -------
    DataArray, shape (shots, samples)
        ``due_h`` is NaN and ``quality`` None for a shot without results.

    Raises
    ------
    ClientError
        No record is stored in these sets, or they differ in length or rate.
    RefusedError, UnreachableError
        The service refuses a request, or does not answer.
    """
    shots: list[Json] = []
    for index in indices:
        scope = {} if method == "pulse_echo" else {"scope": "shot"}
        resource = "thickness" if method == "pulse_echo" else "features"
        items, _ = connection.pages(resource, position=position, set_index=index, **scope)
        results = {row["sequence"]: {name: row[name] for name in ("due_h", "quality")} for row in items}
        for shot in connection.get(f"sets/{position}/{index}/shots")["items"]:
            if shot["outcome"] == "accepted":
                shots.append(
                    {
                        **shot,
                        "set": index,
                        **results.get(shot["sequence"], {"due_h": np.nan, "quality": None}),
                    }
                )
    if not shots:
        raise ClientError(f"no record of position {position} is stored in these sets; see sets()")
    volts, times = [], []
    for shot in shots:
        path = f"waveforms/{position}/{shot['set']}/{shot['shot_index']}"
        time_s, voltage_v = np.load(io.BytesIO(connection.response(path, format="npy").content))
        volts.append(voltage_v)
        times.append(time_s)
    if any(time_s.shape != times[0].shape or (time_s != times[0]).any() for time_s in times):
        raise ClientError(
            f"the records of position {position} in these sets differ in length or rate; choose fewer sets"
        )
    texts = {
        "quality": [shot["quality"] for shot in shots],
        "flags": [" ".join(shot["flags"]) for shot in shots],
    }
    utc = pd.to_datetime([shot["utc"] for shot in shots], utc=True, format="ISO8601").tz_localize(None)
    return xarray.DataArray(
        np.stack(volts),
        dims=("shot", "time"),
        name="voltage",
        attrs={"units": "V", "position": position, "method": method},
        coords={
            "time": ("time", times[0], {"units": "s", "description": "from the trigger"}),
            "due_h": ("shot", [shot["due_h"] for shot in shots], {"units": "h"}),
            "utc": ("shot", utc.to_numpy(dtype="datetime64[ns]")),
            **{name: ("shot", [shot[name] for shot in shots]) for name in PER_SHOT},
            **{name: ("shot", np.array(values, dtype=object)) for name, values in texts.items()},
        },
    )
