"""Read access to a test in Python."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, Self

import pandas as pd
import xarray

from daq_service.catalogue import rows
from daq_service.catalogue.published_columns import Purposes
from daq_service.catalogue.rows import Row
from daq_service.client.connection import Connection, Json, Parameter
from daq_service.client.errors import ClientError, RefusedError
from daq_service.client.frames import build_data_frame
from daq_service.client.waves import read_twin_waveform, read_waveforms


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Event of a test; the fields of ``data`` are those of the API (`docs/reference/api.md`).

    Attributes
    ----------
    id
        Pass it to `Experiment.follow` to continue after it.
    topic, kind
        Such as ``sets`` and ``set_done``; ``gap``: events were skipped, read the tables again.
    """

    id: int
    topic: str
    kind: str
    position: str | None
    set_index: int | None
    unscheduled_index: int
    data: Json


class Experiment:
    """Read-only access to a running or ended test, here or elsewhere (`daq_service.client.open`).

    Hours count from the start of the test: ``from_h`` is included, ``to_h`` is not, None is open. Only
    scheduled sets are read, unless ``purpose`` is ``confirmation`` (unscheduled sets) or ``any``. Every table
    has columns for quality and age, and units in ``attrs["units"]``. Methods raise `RefusedError` where the
    service refuses, with its reason, and `UnreachableError` where no service answers.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close files and connections; `follow` ends."""
        self._connection.close()

    def info(self) -> Json:
        """Read name, rig, clock, schedule, limits, positions and last event id (`/api/v1/info`)."""
        return self._connection.get("info")

    def sets(
        self,
        position: str | None = None,
        *,
        from_h: float | None = None,
        to_h: float | None = None,
        state: str | None = None,
        purpose: Purposes = "planned",
    ) -> pd.DataFrame:
        """Read one row per set and position: due time, state, numbers of shots, reason, and file.

        Parameters
        ----------
        state
            Only sets in this state; None: all.
        """
        filters = {"position": position, "from_h": from_h, "to_h": to_h, "state": state, "purpose": purpose}
        return self._read_table(rows.SetRow, "sets", **filters)

    def features(
        self,
        position: str | None = None,
        *,
        from_h: float | None = None,
        to_h: float | None = None,
        scope: Literal["set", "shot"] = "set",
        purpose: Purposes = "planned",
    ) -> pd.DataFrame:
        """Read features of the solitary waves, one row per set (mean of its valid shots) or per shot."""
        filters = {"position": position, "from_h": from_h, "to_h": to_h, "scope": scope, "purpose": purpose}
        return self._read_table(rows.FeatureRow, "features", **filters)

    def assessments(
        self,
        position: str | None = None,
        *,
        from_h: float | None = None,
        to_h: float | None = None,
        purpose: Purposes = "planned",
    ) -> pd.DataFrame:
        """Read squared distances, limits, outliers and diagnoses, one row per set and transducer."""
        filters = {"position": position, "from_h": from_h, "to_h": to_h, "purpose": purpose}
        return self._read_table(rows.AssessmentRow, "assessments", **filters)

    def baselines(self, position: str | None = None) -> pd.DataFrame:
        """Read the baselines of each position, the newest last: lifecycle, mean, covariance and limits."""
        answer = self._connection.get("baselines", position=position)
        return build_data_frame(rows.BaselineRow, answer["items"], answer["as_of"])

    def thickness(
        self, position: str | None = None, *, from_h: float | None = None, to_h: float | None = None
    ) -> pd.DataFrame:
        """Read wall thickness from pulse echo, m, with its 95 % interval, one row per set and probe."""
        return self._read_table(rows.ThicknessRow, "thickness", position=position, from_h=from_h, to_h=to_h)

    def wall(
        self, position: str | None = None, *, from_h: float | None = None, to_h: float | None = None
    ) -> pd.DataFrame:
        """Read wall thickness from solitary waves, m, with its 90 % interval, one row per set."""
        return self._read_table(rows.WallRow, "wall", position=position, from_h=from_h, to_h=to_h)

    def environment(self, *, from_h: float | None = None, to_h: float | None = None) -> pd.DataFrame:
        """Read supply and climate around each set, one row per set; empty if neither is configured."""
        return self._read_table(rows.EnvironmentRow, "environment", from_h=from_h, to_h=to_h)

    def alarms(self, position: str | None = None, *, active: bool | None = None) -> pd.DataFrame:
        """Read alarms with their evidence, one row per alarm.

        Parameters
        ----------
        active
            True: only active ones; False: only those that have returned to normal; None: all.
        """
        return self._read_table(rows.AlarmRow, "alarms", position=position, active=active)

    def annotations(
        self, position: str | None = None, *, from_h: float | None = None, to_h: float | None = None
    ) -> pd.DataFrame:
        """Read annotations of hours of the test, one row per annotation, including withdrawn ones."""
        return self._read_table(
            rows.AnnotationRow, "annotations", position=position, from_h=from_h, to_h=to_h
        )

    def waveforms(
        self,
        position: str,
        set_index: int | str | None = None,
        *,
        from_h: float | None = None,
        to_h: float | None = None,
    ) -> xarray.DataArray:
        """Read stored waveforms in volts: of one set, of a range of hours, or by default of the newest set.

        Parameters
        ----------
        set_index
            Index of a scheduled set; ``"12.1"`` is the first unscheduled set after set 12.

        Returns
        -------
        DataArray, shape (shots, samples), 8 bytes a sample
            Coordinates: ``time`` in s from the trigger; ``set_index``, ``unscheduled_index``, ``shot_index``,
            ``sequence``, ``due_h``, ``utc``, ``valid``, ``flags`` and ``quality`` of each shot.

        Raises
        ------
        ClientError
            There is no such position, no waveform is stored there, the waveforms differ in length or rate, or
            both a set and a range are given.
        """
        methods = {entry["position"]: entry["method"] for entry in self.info()["positions"]}
        if position not in methods:
            raise ClientError(f"there is no position {position!r}; the positions are {', '.join(methods)}")
        if set_index is not None and (from_h, to_h) != (None, None):
            raise ClientError("give either set_index or a range of hours")
        indices: Sequence[int | str]
        if set_index is not None:
            indices = [set_index]
        elif (from_h, to_h) == (None, None):
            newest = self._connection.get(f"transducers/{position}")["last_set"]
            indices = [] if newest is None else [newest["set_index"]]
        else:
            sets = self.sets(position, from_h=from_h, to_h=to_h)
            indices = sets.loc[sets["n_taken"] > 0, "set_index"].tolist()
        return read_waveforms(self._connection, position, methods[position], indices)

    def twin_waveform(self, position: str, set_index: int | str) -> xarray.DataArray:
        """Simulate the waveform of a set at its wall thickness from the waves, in volts over ``time`` in s.

        It waits for the simulation, up to a minute. Time and height of the incident wave are those of the
        set. ``attrs`` has the curve of the twin, and thickness, hour and quality of the wall.
        """
        return read_twin_waveform(self._connection, position, set_index)

    def follow(self, *topics: str, after: int | None = None) -> Iterator[Event]:
        """Yield new events in order, also over restarts of recorder and service, until `close`.

        It blocks while there is none. Raise RefusedError if the service refuses; UnreachableError only at the
        start, if ``after`` is None.

        Parameters
        ----------
        topics
            Such as ``sets``, ``assessments``, ``alarms``; none: all.
        after
            Id of the last known event; None: only new events.
        """
        if after is None:
            try:
                after = int(self.info()["last_event_id"])
            except RefusedError as error:
                if not error.type.endswith(":no-data-yet"):
                    raise
                after = 0
        for event in self._connection.events(after, ",".join(topics) or None):
            yield Event(
                id=event["id"],
                topic=event["topic"],
                kind=event["kind"],
                position=event.get("position"),
                set_index=event.get("set_index"),
                unscheduled_index=event.get("unscheduled_index", 0),
                data=event,
            )

    def _read_table(self, kind: type[Row], resource: str, **filters: Parameter) -> pd.DataFrame:
        """Read all pages of a listing of the API as a data frame with the columns of a kind of row.

        Raise RefusedError or UnreachableError as `Connection.get` does.
        """
        items, as_of = self._connection.pages(resource, **filters)
        return build_data_frame(kind, items, as_of)
