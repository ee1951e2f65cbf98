"""Wall thickness from a pulse-echo record, and the condition of its alarm (equation 17)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from analysis.errors import AnalysisError
from analysis.statistics.rules import AlarmRule, AlarmState, update_alarm_state
from analysis.ultrasound.reading import EchoReading, measure_wall_thickness
from analysis.ultrasound.thickness import EXTRACTOR_VERSION, EchoReference, find_reference_echo
from analysis.waves.features import ShotFeatures
from daq_service.alarms.states import Condition
from daq_service.archive import ArchiveError, SetRecord
from daq_service.assessment.assessor import PositionResult
from daq_service.catalogue.rows import MEASURED, ThicknessRow
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import DueSet, PulseEchoRecord, Waveform

FORMULA = "th = th0 - (UT0 - UT) / (UT0 - D) th0, equation 17"


@dataclass(frozen=True, slots=True, kw_only=True)
class PulseEchoState:
    """State of a probe after a set; ``reference`` is None before the first record with an echo."""

    alarm: AlarmState = field(default_factory=AlarmState)
    reference: EchoReference | None = None


class PulseEchoAssessor:
    """Assessor of one ultrasonic probe; the first record with an echo is its reference.

    Attributes
    ----------
    lost
        First reading, whose record is lost, with the error; None if it is not lost.
    """

    baseline_id = None

    def __init__(self, position: str, settings: Settings) -> None:
        self.position = position
        self._settings = settings
        self.initial_thickness_m = settings.ultrasound.initial_thickness_m
        self._wall_limit_m = settings.find_wall_limit_m(position)
        self._rule = AlarmRule(k=settings.alarms.k, n=settings.alarms.n)
        self.state = PulseEchoState()
        self.lost: tuple[ThicknessRow, ArchiveError] | None = None

    def set_reference(self, reference: EchoReference) -> None:
        """Replace the reference echo that later records are compared with; the alarm state stays."""
        self.state = replace(self.state, reference=reference)

    def add(self, row: ThicknessRow) -> None:
        """Update the k-of-n state of the thickness alarm with one reading; a bad one counts as unknown."""
        alarm = update_alarm_state(self.state.alarm, self.exceeds_limit(row), self._rule)
        self.state = replace(self.state, alarm=alarm)

    def enable(self) -> None:
        """Do nothing, because a probe is never disabled."""

    def assess_set(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Assess the first record of this probe in a set; return an empty result if the set has none."""
        del features
        echoes = [echo for echo in record.echoes if echo.key.position == self.position]
        return self.assess(due, echoes[0]) if echoes else PositionResult()

    def assess_unscheduled(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Raise AssertionError, because a probe takes no confirmation sets."""
        raise AssertionError(f"{due} is no set of a striker")

    def assess_empty_set(self, due: DueSet, n_tried: int) -> PositionResult:
        """Return an empty result: an instrument that does not respond is an alarm of the rig."""
        del due, n_tried
        return PositionResult()

    def assess(self, due: DueSet, echo: PulseEchoRecord) -> PositionResult:
        """Compute the thickness of one record and the condition of its alarm; update the state.

        The first record with an echo becomes the reference. A record without an echo gives a reading of
        quality ``bad`` and an invalid sequence; a good reading of a clipped record becomes ``suspect``. No
        analysis error is raised: the note has its text.
        """
        settings = self._settings.ultrasound
        try:
            reference = self.state.reference
            if reference is None:
                reference = self.build_reference_echo(echo.waveform, settings.initial_thickness_m)
                self.set_reference(reference)
            reading = measure_wall_thickness(
                echo.waveform,
                reference,
                delay_s=settings.delay_s,
                initial_thickness_m=settings.initial_thickness_m,
                element_separation_m=settings.element_separation_m,
            )
        except AnalysisError as error:
            reading = EchoReading(reason=str(error))
        flags = _find_echo_flags(reading, echo)
        if "clipped" in flags and reading.quality == "good":
            # Both half-waves of the carrier are clipped alike: the time is right, the amplitude is not.
            reason = "the record is clipped: lower the gain or take a larger range"
            reading = replace(reading, quality="suspect", reason=reason)
        row = ThicknessRow(
            set_index=due.set_index,
            unscheduled_index=due.unscheduled_index,
            position=self.position,
            sequence=echo.sequence,
            due_h=due.due_h,
            extractor_version=EXTRACTOR_VERSION,
            quality=reading.quality,
            **{name: getattr(reading, name) for name in MEASURED[ThicknessRow]},
        )
        self.add(row)
        usable = row.quality != "bad"
        return PositionResult(
            thickness=[row],
            conditions=[self._build_condition(due, row, reading)],
            n_valid=int(usable),
            shot_flags={echo.sequence: flags},
            invalid=frozenset(() if usable else (echo.sequence,)),
            note=reading.reason,
        )

    def build_reference_echo(self, waveform: Waveform, thickness_m: float) -> EchoReference:
        """Find the reference echo in a record of a wall of known thickness, m.

        Raises
        ------
        AnalysisError
            The record has no such echo.
        """
        settings = self._settings.ultrasound
        return find_reference_echo(
            waveform,
            delay_s=settings.delay_s,
            initial_thickness_m=thickness_m,
            velocity_m_per_s=settings.velocity_m_per_s,
        )

    def exceeds_limit(self, row: ThicknessRow) -> bool | None:
        """Return whether the complete 95 % interval of a reading is below the limit of the alarm.

        A reading that was stored before there were intervals counts by its thickness. None for a reading that
        is bad, whose thickness is missing or not finite, or is below the limit, but its interval is not.
        """
        wall_m = row.thickness_m
        if row.quality == "bad" or wall_m is None or not math.isfinite(wall_m):
            return None
        if (wall_m if row.interval_high_m is None else row.interval_high_m) < self._wall_limit_m:
            return True
        return None if wall_m < self._wall_limit_m else False

    def _build_condition(self, due: DueSet, row: ThicknessRow, reading: EchoReading) -> Condition:
        """Return the condition ``thickness_low`` (priority high) after a reading; present by the k-of-n rule.

        Its ``times_limit`` (loss divided by limit) is None for a bad or missing loss; lengths in the evidence
        are in m.
        """
        remaining_m, loss_m = row.thickness_m, row.thickness_loss_m
        alarm, reference = self.state.alarm, self.state.reference
        return Condition(
            position=self.position,
            kind="thickness_low",
            alarm_class="damage",
            priority="high",
            present=alarm.active,
            times_limit=None
            if loss_m is None or row.quality == "bad" or not math.isfinite(loss_m)
            else loss_m / (self.initial_thickness_m - self._wall_limit_m),
            evidence={
                "formula": FORMULA,
                "rule": {"k": self._rule.k, "n": self._rule.n},
                "set_index": due.set_index,
                "thickness_m": remaining_m,
                "interval_m": None if remaining_m is None else [row.interval_low_m, row.interval_high_m],
                "roughness_rms_m": reading.roughness_rms_m,
                "limit_m": self._wall_limit_m,
                "travel_time_s": row.travel_time_s,
                "reference_travel_time_s": None if reference is None else reference.travel_time_s,
                "delay_s": self._settings.ultrasound.delay_s,
                "extractor_version": EXTRACTOR_VERSION,
            },
        )


def _find_echo_flags(reading: EchoReading, echo: PulseEchoRecord) -> tuple[str, ...]:
    """Return the flags of an echo: ``no_echo`` for a bad reading, ``clipped`` for a clipped record.

    Of an average, the settings of the instrument give the number of clipped records.
    """
    clipped = echo.waveform.clipped or float(echo.settings.get("clipped_records", 0.0)) > 0.0
    return (("no_echo",) if reading.quality == "bad" else ()) + (("clipped",) if clipped else ())
