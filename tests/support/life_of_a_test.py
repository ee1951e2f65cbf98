"""A test on a rig in memory, with its sets in files, with events that cannot be computed again."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

from daq_service.archive.layout import build_set_image
from daq_service.assessment.results_in_file import read_set_results
from daq_service.catalogue.experiment_file import ensure_experiment_file
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.rows import EventRow, SetRow
from hardware_drivers.measurement import ShotKey
from support.filed_archive import FiledArchive
from support.memory_line import Answer, Line, healthy, silent
from support.stored_files import read_set

ORDERS: dict[tuple[str, int, int], tuple[str, dict[str, Any]]] = {
    ("B", 1, 1): ("disable", {"position": "C", "note": "a loose cable"}),
    ("B", 3, 0): ("enable", {"position": "C"}),
    ("D", 3, 1): ("renew_baseline", {"position": "C", "note": "coupled anew"}),
    ("B", 4, 2): ("pause", {"note": "hands in the rig"}),
    ("B", 10, 0): ("enable", {"position": "D"}),
    ("C", 10, 0): ("annotate", {"from_h": 4.0, "to_h": 5.0, "position": "B", "text": "couplant renewed"}),
    ("C", 10, 1): ("annotate", {"from_h": 3.0, "text": "door slammed"}),
    ("B", 11, 1): ("take_out_of_service", {"alarm_id": 1, "reason": "cable is being replaced"}),
    ("B", 11, 2): ("shelve_alarm", {"alarm_id": 2, "for_h": 0.2, "reason": "known"}),
    ("C", 11, 0): ("withdraw_annotation", {"annotation_id": 1}),
    ("B", 11, 0): ("acknowledge_alarm", {"alarm_id": 2, "note": "seen"}),
}


STOPS = [("B", 4, 2), ("C", 8, 3)]


def run(line: Line, **options: Any) -> None:
    """Run a recorder on the archive of the folder, as a session does; the history follows it."""
    archive = FiledArchive(line.folder)
    line.run(archive=archive, **options)
    archive.close()
    with line.catalogue(writer=True) as catalogue:
        for set_index, file in catalogue.list_sets_without_digest().items():
            path = line.folder / file  # with a copy of its results, as the recorder's worker makes it
            path.write_bytes(
                build_set_image(replace(read_set(path), results=read_set_results(catalogue, set_index)))
            )
            catalogue.store_digest(set_index, file, archive.digest(file))
        ensure_experiment_file(line.folder, catalogue.read_experiment())
        HistoryFollower(line.folder, catalogue).begin()


def lived(folder: Path) -> Line:
    """Record a test with all irreproducible data: gaps, commands, pauses, disabled transducers, repetitions.

    D is silent from set 2 on, retires by rule and is enabled; the recorder is stopped twice, and down for
    one set; baselines freeze, C's is retired before and started again; the wall changes at B.
    """
    line = Line(folder, listen_every_s=0.0)
    orders, stops, stop = dict(ORDERS), set(STOPS), threading.Event()

    def script(key: ShotKey) -> Answer:
        place = (key.position, key.set_index, key.shot_index)
        if place in orders:
            kind, arguments = orders.pop(place)
            line.order(kind, **arguments)
        if place in stops:
            stops.remove(place)
            stop.set()
        if key.position == "D" and 2 <= key.set_index < 10:
            return silent("noisy")
        if key.position == "B" and key.shot_index == 1 and key.attempt == 0 and key.set_index == 2:
            return silent("clipped")
        return healthy(key, 0.5 if key.position == "B" and key.set_index > 8 else 0.0)

    line.script = script
    run(line, stop=stop)
    stop.clear()
    line.order("resume")
    run(line, stop=stop)
    stop.clear()
    run(line, start_h=5.6, cause="the power was off")
    with line.catalogue() as catalogue:
        rows = catalogue.rows(SetRow)
        kinds = {event.kind for event in catalogue.rows(EventRow)}
        states = {row.state for row in rows}
    assert states == {"done", "partial", "missed", "disabled"}
    assert {"alarm_acknowledged", "alarm_reset", "pause", "resume", "baseline_frozen"} <= kinds
    assert {"baseline_retired", "baseline_collecting"} <= kinds
    assert {"annotation_added", "annotation_withdrawn", "alarm_out_of_service", "alarm_shelved"} <= kinds
    return line
