"""Extract features of sets in an executor ahead of the sequential assessment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field

from analysis.waves.features import ShotFeatures
from daq_service.acquisition.shot_features import FeaturesOf
from daq_service.archive import SetRecord, SetReference
from daq_service.errors import SolimonError
from daq_service.processes.executors import list_worker_lost_errors
from hardware_drivers.measurement import SetKey, Shot, ShotKey, Stamp, Waveform

SETS_AHEAD = 2
"""Sets ahead per worker: no worker waits, and memory holds few records."""


@dataclass(slots=True, kw_only=True, eq=False)
class ExtractedAhead:
    """Reads sets in order while features of the next ones are extracted.

    Attributes
    ----------
    features_of
        Gives the features of a shot.
    references
        All sets in approximately the order of the requests.
    """

    executor: Executor
    workers: int
    features_of: FeaturesOf
    read: Callable[[SetReference], SetRecord]
    references: Iterator[SetReference]
    _under_way: dict[SetReference, tuple[SetRecord, Future[dict[int, ShotFeatures]]]] = field(
        default_factory=dict
    )
    _of_set: dict[SetKey, Future[dict[int, ShotFeatures]]] = field(default_factory=dict)

    def read_set(self, reference: SetReference) -> SetRecord:
        """Return a set's record and start the extraction of following sets; call `features` next.

        Reads until two sets per worker are under way. Errors of ``read`` occur up to that many sets early.
        """
        for following in self.references:
            self._start_extraction(following)
            if reference in self._under_way and len(self._under_way) > SETS_AHEAD * self.workers:
                break
        if reference not in self._under_way:
            self._start_extraction(reference)
        record, future = self._under_way.pop(reference)
        self._of_set[record.set_key] = future
        return record

    def _start_extraction(self, reference: SetReference) -> None:
        """Read a set and submit the extraction of its features to the executor; raise errors of ``read``."""
        record = self.read(reference)
        # Without truth and settings of a shot: extraction does not use them.
        records = [(shot.sequence, shot.key, shot.stamp, shot.waveform) for shot in record.shots]
        future = self.executor.submit(_extract_in_worker, self.features_of, records)
        self._under_way[reference] = record, future

    def features(self, record: SetRecord) -> Mapping[int, ShotFeatures]:
        """Wait for the features of a set that `read_set` returned; return them by sequence, once.

        Raises SolimonError if workers end by themselves again and again, KeyError for any other set.
        """
        try:
            return self._of_set.pop(record.set_key).result()
        except list_worker_lost_errors() as error:
            raise SolimonError(
                "workers ended by themselves again and again (killed, or out of memory); choose fewer "
                "--workers, or --executor threads"
            ) from error


def _extract_in_worker(
    features_of: FeaturesOf, records: Sequence[tuple[int, ShotKey, Stamp, Waveform]]
) -> dict[int, ShotFeatures]:
    """Extract the features of shots in a worker process; return them by sequence.

    ``records`` has sequence, key, time stamp and waveform of each.
    """
    shots = [
        Shot(sequence=sequence, key=key, stamp=stamp, waveform=waveform)
        for sequence, key, stamp, waveform in records
    ]
    return {shot.sequence: features_of(shot) for shot in shots}
