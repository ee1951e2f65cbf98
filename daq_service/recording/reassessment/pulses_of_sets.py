"""Align records at the peak of the incident wave: mean of a set and mean of the baseline."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.waves.quality_gate import ACCEPTED
from daq_service.archive import SetRecord, SetReference
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import BaselineRow, FeatureRow, SetRow, ShotRow

FIRST_S, LAST_S, STEP_S = -150e-6, 750e-6, 1e-6
"""From the incident wave's peak: both waves and their echo; a record that is shorter ends before."""
MOST_BASELINE_SETS = 200
"""Of a larger baseline so many are drawn, evenly spread: their mean is no other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pulses:
    """Means of records, shape (n,) each; NaN where no record reaches.

    Attributes
    ----------
    time_s
        From the peak of the incident wave.
    baseline_v, baseline_sd_v
        Mean over the baseline's sets of each set's mean record, and their standard deviation.
    set_v
        Mean record of the set.
    """

    time_s: NDArray[np.float64]
    baseline_v: NDArray[np.float64]
    baseline_sd_v: NDArray[np.float64]
    set_v: NDArray[np.float64]


def read_mean_pulses(
    catalogue: Catalogue,
    read_set: Callable[[SetReference], SetRecord],
    baseline: BaselineRow | None,
    position: str,
    set_index: int,
) -> Pulses | None:
    """Read the records of a set and of its baseline again and average each; None if either has none.

    Of a baseline with more than 200 sets, evenly spread ones are read. ``read_set`` raises ArchiveError.
    """
    indices = [] if baseline is None else baseline.provenance.get("set_indices", [])
    spread = indices[:: math.ceil(len(indices) / MOST_BASELINE_SETS)] if indices else []
    time_s = np.arange(FIRST_S, LAST_S, STEP_S)
    means = [_average_records(catalogue, read_set, position, index, time_s) for index in spread]
    healthy = [mean for mean in means if mean is not None]
    of_set = _average_records(catalogue, read_set, position, set_index, time_s)
    if not healthy or of_set is None:
        return None
    table = np.array(healthy)
    return Pulses(time_s=time_s, baseline_v=table.mean(axis=0), baseline_sd_v=table.std(axis=0), set_v=of_set)


def _average_records(
    catalogue: Catalogue,
    read_set: Callable[[SetReference], SetRecord],
    position: str,
    set_index: int,
    time_s: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Average the accepted records of a set over its shots, in V at ``time_s`` (s) after the incident peak.

    The result has the shape of ``time_s``, with NaN where a record ends. Only valid shots count, or all with
    an incident wave if none is valid; None if there are none. The median before the trigger is subtracted
    from each record.
    """
    (its_set,) = catalogue.rows(SetRow, position=position, set_index=set_index)
    if its_set.file is None:
        return None
    accepted = {
        row.sequence: row.valid
        for row in catalogue.rows(ShotRow, position=position, set_index=set_index)
        if row.outcome == ACCEPTED
    }
    peaks_s = {
        row.sequence: row.isw_time_s
        for row in catalogue.rows(FeatureRow, position=position, set_index=set_index, scope="shot")
        if row.sequence in accepted and row.isw_time_s is not None
    }
    valid = {sequence: peak for sequence, peak in peaks_s.items() if accepted[sequence or 0]}
    chosen = valid or peaks_s
    records = []
    for shot in read_set(SetReference(its_set.file)).shots:
        if (peak_s := chosen.get(shot.sequence)) is not None:
            volts, at_s = shot.waveform.volts(), shot.waveform.time_s()
            quiet_v = float(np.median(volts[: max(1, shot.waveform.pretrigger_samples)]))
            records.append(np.interp(time_s + peak_s, at_s, volts - quiet_v, left=np.nan, right=np.nan))
    return np.array(records).mean(axis=0) if records else None
