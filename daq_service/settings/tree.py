"""One tree of settings: read once from TOML, environment on top, then passed on in small parts.

Every value has a bound, a description and its unit in its name. The defaults are the paper's
experiment, so a file needs only what differs. ``SOLIMON_SECTION__KEY`` overrides a key from the
environment, for example ``SOLIMON_WEB__PORT=8080``.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from datetime import date
from typing import ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pydantic.main import IncEx
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from analysis.statistics.rules import MINIMUM_SETS, NOMINAL_RATE, AlarmRule, HoleRule
from analysis.waves.quality_gate import MINIMUM_VALID_SHOTS, RESTRIKE_FLAGS, RestrikeFlag, RestrikeRule
from daq_service.clock import parse_utc
from daq_service.settings.alarm_delays import CONTACTS, EARLIER_ALARM_KINDS, AlarmKindSettings
from daq_service.settings.notifications import NotificationSettings
from daq_service.settings.rig import RigSettings
from daq_service.settings.tables import Tables
from daq_service.settings.web import WebSettings
from hardware_drivers.daqmx import parameters as daqmx
from hardware_drivers.drive_parameters import CLIMATE_KEYS, WATCH_KEYS
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE, Method
from hardware_drivers.niscope import parameters as niscope
from hardware_drivers.serial_port import parameters as serial_port
from simulator.parameters.chain import ChainParameters
from simulator.parameters.experiment import TwinParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters

log = logging.getLogger(__name__)

FILLED_AT_MOST = 0.99
"""Of the time from set to set by strikes: a set that fills all of it begins later each time, until one is
missed."""
STRENGTHS: dict[str, IncEx | bool] = {
    "yield_strength_pa": True,
    "spheres": {"__all__": {"yield_strength_pa"}},
}

HASHED_OUT: Mapping[str, IncEx | bool] = {
    "site": True,
    "web": True,
    "notifications": True,
    "clock": {"pace_h_per_s", "doubt_after_h"},
    "schedule": {"end_h"},
    "alarms": {"kinds"},
    "storage": True,
    "chain": STRENGTHS,
    "plate": {"yield_strength_pa"},
    "positions": {
        "__all__": {"calibration": True, "chain": STRENGTHS, "plate": {"yield_strength_pa"}},
    },
    # Where instruments are reached and how long they are waited for: a replugged cable is no other test.
    "rig": {
        "read_timeout_s": True,
        "stall_timeout_s": True,
        "daqmx": set(daqmx.REACHED_BY),
        "niscope": set(niscope.REACHED_BY),
        "supply": set(serial_port.SUPPLY_REACHED_BY),
        "climate": set(serial_port.CLIMATE_REACHED_BY),
        "drive": set(WATCH_KEYS | {"order_timeout_s", "readback_tolerance_v", "readback_tolerance_a"}),
        "air": set(CLIMATE_KEYS),
    },
}
"""Not part of a data folder's identity: they change how a test is watched, not what is measured."""


class Section(BaseModel):
    """A table of the file: unknown keys are refused, values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ClockSettings(Section):
    """Which clock the experiment runs on."""

    kind: Literal["simulated", "wall"] = "simulated"
    """`simulated` jumps to the next due time (twin only); `wall` waits for it."""
    epoch: str = "2024-01-01T00:00:00Z"
    """Hour 0 of the simulated clock. On the wall clock hour 0 is the first start in an empty data folder."""
    pace_h_per_s: float | None = Field(default=None, gt=0.0, le=1e4)
    """Hours of experiment a second on the simulated clock; absent: as fast as it goes."""
    doubt_after_h: float = Field(default=72.0, gt=0.0, le=1e4)
    """Time after the last stored set at which an unsynchronized clock is unverified after a reboot."""

    @property
    def is_paced(self) -> bool:
        """Return whether the simulated clock runs at a fixed rate (``pace_h_per_s``) instead of jumping."""
        return self.kind == "simulated" and self.pace_h_per_s is not None

    @field_validator("epoch")
    @classmethod
    def _validate_epoch(cls, text: str) -> str:
        """Return the epoch unchanged if it is a UTC time; raise ValueError otherwise."""
        parse_utc(text)
        return text


class PhaseSettings(Section):
    """Sets at a fixed interval up to an hour."""

    until_h: float = Field(gt=0.0, le=1e6)
    """Hour at which the phase ends; a set is due then."""
    interval_h: float = Field(gt=0.0, le=1e4)
    """Hours between two sets."""


class ScheduleSettings(Section):
    """When sets are due and what a set is."""

    phases: tuple[PhaseSettings, ...] = Field(
        default=(PhaseSettings(until_h=75.0, interval_h=0.5), PhaseSettings(until_h=350.0, interval_h=1.0)),
        min_length=1,
    )
    """Paper: every 30 min until about 75 h (measurement 150), then every hour to 350 h: 425 sets."""
    end_h: float | None = Field(default=None, gt=0.0)
    """Stop after this hour; absent: at the end of the last phase."""
    shots_per_set: int = Field(default=10, ge=1, le=1000)
    """Strikes of each transducer in a set (paper: 10)."""
    shot_interval_s: float = Field(default=4.0, gt=0.0, le=3600.0)
    """Seconds between two strikes of a transducer (paper: 0.25 Hz)."""

    @model_validator(mode="after")
    def _check_phase_order(self) -> Self:
        """Return the schedule; raise ValueError unless its phases end at increasing hours, above 0."""
        before = 0.0
        for phase in self.phases:
            if phase.until_h <= before:
                raise ValueError(
                    f"until_h is {phase.until_h} h; phases must end one after the other (> {before} h)"
                )
            before = phase.until_h
        return self


class CalibrationSettings(Section):
    """External calibration of a position's sensor, by its certificate."""

    certificate: str = ""
    """Number of the calibration certificate."""
    calibrated_on: date | None = None
    """Date of the calibration."""
    due_on: date | None = None
    """Date until which it is valid; `check-config` and `doctor` warn after it."""
    sensitivity_v_per_n: float | None = Field(default=None, gt=0.0, le=1e6)
    """Voltage per force of the sensor disk; stored and reported, not used in any value."""

    @model_validator(mode="after")
    def _check_date_order(self) -> Self:
        """Return the table; raise ValueError if the calibration is due before it was made."""
        if self.calibrated_on and self.due_on and self.due_on < self.calibrated_on:
            raise ValueError(
                f"due_on = {self.due_on} precedes calibrated_on = {self.calibrated_on}; correct one"
            )
        return self

    def is_overdue(self, today: date) -> bool:
        """Return whether the calibration is due before a date; False without a due date."""
        return self.due_on is not None and self.due_on < today


class WaveSettings(Section):
    """What is expected of a transducer's record; what is not given follows from its chain."""

    isw_fwhm_s: float | None = Field(default=None, gt=0.0, le=1.0)
    """Full width at half maximum of the incident wave; every time and window goes with it."""
    psw_earliest_s: float | None = Field(default=None, gt=0.0, le=1.0)
    """Earliest peak of a reflected wave after that of the incident wave."""
    psw_latest_s: float | None = Field(default=None, gt=0.0, le=1.0)
    """Latest peak of a reflected wave after that of the incident wave."""
    no_psw_below_fraction: float | None = Field(default=None, gt=0.0, lt=1.0)
    """Amplitude ratio below which there is no reflected wave."""
    deepest_pull_fraction: float | None = Field(default=None, gt=0.0, lt=1.0)
    """How far a sound record falls below its quiet level, of the incident wave's amplitude."""


class PositionSettings(Section):
    """One monitored place: who looks at it and what is expected there."""

    method: Method
    """`solitary_wave`: a chain with striker and sensor; `pulse_echo`: an ultrasonic probe."""
    label: str = ""
    """Name of the position for people."""
    serial_number: str = ""
    """Serial number of the transducer or probe."""
    calibration: CalibrationSettings = CalibrationSettings()
    """External calibration of this position's sensor."""
    minimum_wall_m: float | None = Field(default=None, gt=0.0, le=1.0)
    """Wall thickness below which `thickness_low` is raised. Of a probe the larger limit counts, this one or
    that by `alarms.thickness_loss_fraction`; a transducer has no such alarm without this key."""
    chain: ChainParameters = ChainParameters()
    """This transducer's chain; keys not given are those of `[chain]`."""
    plate: PlateParameters = PlateParameters()
    """The plate under this transducer; keys not given are those of `[plate]`."""
    corrosion: CorrosionParameters = CorrosionParameters()
    """Footprint assumed here; keys not given are those of `[corrosion]`."""
    waves: WaveSettings = WaveSettings()
    """Width, windows and limits of this transducer's waves, where the chain does not tell them."""


def _default_positions() -> dict[str, PositionSettings]:
    """Build the default positions A (ultrasonic probe) and B to D (transducers) of Table 1 of the paper."""
    small, large = CorrosionParameters(size_m=25.4e-3), CorrosionParameters(size_m=50.8e-3)
    return {
        "A": PositionSettings(method=PULSE_ECHO, label="Ultrasonic probe, 25.4 mm patch", corrosion=small),
        "B": PositionSettings(method=SOLITARY_WAVE, label="HNSW transducer, 25.4 mm patch", corrosion=small),
        "C": PositionSettings(method=SOLITARY_WAVE, label="HNSW transducer, 50.8 mm patch", corrosion=large),
        "D": PositionSettings(
            method=SOLITARY_WAVE, label="HNSW transducer, pristine control", corrosion=small
        ),
    }


class UltrasoundSettings(Section):
    """Pulse-echo thickness by equation 17."""

    initial_thickness_m: float = Field(default=6.35e-3, gt=0.0, le=1.0)
    """Wall at hour 0 (paper: 6.35 mm)."""
    delay_s: float = Field(default=8.0e-6, ge=0.0, le=1e-3)
    """Delay D of the dual transducer (assumption: the paper prints no value; calibrate the probe's own)."""
    velocity_m_per_s: float = Field(default=5900.0, gt=0.0, le=2e4)
    """Longitudinal velocity that finds the first echo (assumption: steel); eq. 17 itself needs none."""
    element_separation_m: float = Field(default=0.0, ge=0.0, le=0.1)
    """Distance of a dual probe's elements: takes off their V-shaped way; 0 is the paper's equation 17."""

    @property
    def delay_is_assumed(self) -> bool:
        """Return whether the delay is the default one, an assumption instead of the probe's own."""
        return self.delay_s == type(self).model_fields["delay_s"].default  # type: ignore[no-any-return] # of pydantic


class FeatureSettings(Section):
    """How the shots of a set become one feature vector."""

    of_set: Literal["mean_of_shots", "averaged_waveform"] = "mean_of_shots"
    """`mean_of_shots`: features of each valid shot, averaged; `averaged_waveform`: features of the averaged
    record, the paper's way. The two are different quantities: a folder holds one kind."""


class QualitySettings(Section):
    """Treatment of poor shots, and of a transducer that gives nothing else."""

    restrike_flags: tuple[RestrikeFlag, ...] = RESTRIKE_FLAGS
    """Flags of a shot that is repeated once; both records are stored, the better one counts."""
    restrikes_per_set: int = Field(default=RestrikeRule().restrikes_per_set, ge=0, le=1000)
    """Repetitions of each transducer in a set; 0: none."""
    no_data_sets: int = Field(default=2, ge=1, le=1000)
    """Consecutive sets below `baseline.minimum_valid_shots` that raise `few_valid_shots`."""
    retire_after_sets: int = Field(default=10, ge=0, le=100_000)
    """Consecutive such sets after which the transducer is disabled until `solimon enable`; 0: never."""


class BaselineSettings(Section):
    """Sets of the initial state, with which later sets are compared."""

    hours: float = Field(default=24.0, gt=0.0, le=1e6)
    """Sets due up to this hour are the baseline (paper: the first 24 h)."""
    minimum_sets: int = Field(default=MINIMUM_SETS, ge=7, le=100_000)
    """Fewer valid sets give no limit, with the reason."""
    minimum_valid_shots: int = Field(default=MINIMUM_VALID_SHOTS, ge=1, le=1000)
    """Valid shots that a set needs for a feature (of `schedule.shots_per_set`)."""
    approval: Literal["automatic", "by_a_person"] = "automatic"
    """`automatic`: the baseline needs no approval, and the page shows that; `by_a_person`: it is proposed
    until `solimon approve-baseline`. Either way it is used from its last set on."""


class NoveltySettings(Section):
    """Limits of the Mahalanobis squared distance (equation 16)."""

    limit: str = "f_predictive"
    """Limit beyond which a set is an outlier, by its name; the others are computed and shown too."""
    false_alarm_rate: float = Field(default=NOMINAL_RATE, gt=0.0, lt=0.5)
    """Chance of a healthy set beyond the F limit (paper: 99.73 % confidence)."""

    @field_validator("limit")
    @classmethod
    def _check_limit_name(cls, limit: str) -> str:
        """Return the current name of the limit (``chart`` becomes ``mewma``); ValueError if unknown."""
        limit = {"chart": "mewma"}.get(limit, limit)  # stored by earlier versions
        if limit == cls.model_fields["limit"].default:
            return limit  # the list comes with SciPy, which readers of a folder do not need
        from analysis.statistics.named_limits import LIMITS

        if limit not in LIMITS:
            raise ValueError(f"there is no limit {limit!r}; choose from {', '.join(LIMITS)}")
        return limit


class AlarmSettings(Section):
    """When an outlier becomes an alarm."""

    decides_by: Literal["chart", "k_of_n"] = "chart"
    """Rule that raises `wall_change`: the control chart, or `k` outliers of `n` sets."""
    false_alarms_per_sensor_year: float = Field(default=0.2, gt=0.0, le=365.0)
    """Design false-alarm rate of the chart for each transducer (0.2: one alarm in five years)."""
    false_alarms_per_year: float | None = Field(default=None, gt=0.0, le=3650.0)
    """The same for all transducers together, in equal shares; absent: each has its own."""
    k: int = Field(default=AlarmRule().k, ge=1, le=100)
    """Outliers among the last `n` assessed sets that raise the alarm."""
    n: int = Field(default=AlarmRule().n, ge=1, le=100)
    """Assessed sets that the rule considers."""
    hole_shots: int = Field(default=HoleRule().shots, ge=1, le=1000)
    """Shots of a set without a reflected wave that point at a hole."""
    hole_sets: int = Field(default=HoleRule().consecutive_sets, ge=1, le=100)
    """Consecutive such sets that disable the transducer with a hole alarm."""
    thickness_loss_fraction: float = Field(default=0.10, gt=0.0, lt=1.0)
    """Loss read by the ultrasonic probe that raises its alarm (k of n), as a part of the initial wall."""
    confirmation_sets_a_day: int = Field(default=2, ge=0, le=24)
    """Confirmation sets that solimon may request at a transducer within 24 h of the test; 0: none."""
    contacts: dict[str, str] = Field(default_factory=dict)
    """Person to ask, with telephone number, by responsibility: `wall`, `rig`, `computer`, `cell`."""
    kinds: dict[str, AlarmKindSettings] = Field(default_factory=dict)
    """Delays and deadband by kind of alarm; other kinds follow their condition at once."""

    @field_validator("kinds", mode="before")
    @classmethod
    def _convert_old_kinds(cls, kinds: object) -> object:
        """Return the table with current names of alarm kinds; other values are returned unchanged."""
        if not isinstance(kinds, Mapping):
            return kinds
        return {EARLIER_ALARM_KINDS.get(kind, kind): rule for kind, rule in kinds.items()}

    @field_validator("contacts")
    @classmethod
    def _check_contacts(cls, contacts: dict[str, str]) -> dict[str, str]:
        """Return the table; raise ValueError for a responsibility that no guidance names."""
        if unknown := sorted(set(contacts) - set(CONTACTS)):
            raise ValueError(f"{', '.join(unknown)} is none of {', '.join(CONTACTS)}")
        return contacts

    @field_validator("kinds")
    @classmethod
    def _check_kind_delays(cls, kinds: dict[str, AlarmKindSettings]) -> dict[str, AlarmKindSettings]:
        """Return the table; raise ValueError for a kind that may not have its delays or its deadband."""
        for kind, rule in kinds.items():
            rule.require_valid_delays(kind)
        return kinds

    @model_validator(mode="after")
    def _check_k_of_n(self) -> Self:
        """Return the table; raise ValueError if k exceeds n."""
        if self.k > self.n:
            raise ValueError(f"k is {self.k}; it must be at most n = {self.n}")
        return self


class StorageSettings(Section):
    """Where data go."""

    folder: str = "solimon-data"
    """Data folder, relative to the configuration file."""
    memory_mb: int = Field(default=512, ge=1, le=1_000_000)
    """Records kept in memory, in MB, while the disk takes nothing; sets due beyond are missed."""
    reserve_mb: int = Field(default=64, ge=0, le=100_000)
    """Space kept in a file of the data folder and given back when the disk is full, so that a stop is still
    stored in order; 0: none."""
    warn_free_fraction: float = Field(default=0.20, ge=0.0, le=0.9)
    """Free part of the volume below which an event warns."""
    alarm_free_fraction: float = Field(default=0.10, ge=0.0, le=0.9)
    """Free fraction below which the alarm `disk_space` is active."""
    stop_free_fraction: float = Field(default=0.05, ge=0.0, le=0.9)
    """Free fraction below which storage stops; the test continues by itself when space is freed."""
    volume_gb: float = Field(default=1000.0, gt=0.0, le=1e9)
    """Largest size that these fractions refer to: 5 % of a volume of 10 TB would be far too much."""

    @model_validator(mode="before")
    @classmethod
    def _remove_old_journal_key(cls, values: object) -> object:
        """Return the values without the former key ``journal``; log a warning unless it was true."""
        if not (isinstance(values, dict) and "journal" in values):
            return values
        if values["journal"] is not True:
            log.warning("storage.journal is ignored: every shot goes to the journal. Remove the key.")
        return {name: value for name, value in values.items() if name != "journal"}

    @model_validator(mode="after")
    def _check_limit_order(self) -> Self:
        """Return the table; raise ValueError unless stop, alarm and warn fraction are in ascending order."""
        if not self.stop_free_fraction <= self.alarm_free_fraction <= self.warn_free_fraction:
            raise ValueError(
                f"stop_free_fraction is {self.stop_free_fraction:g}, alarm_free_fraction "
                f"{self.alarm_free_fraction:g}, warn_free_fraction {self.warn_free_fraction:g}; each must be "
                "at most the next"
            )
        return self


class Settings(BaseSettings):
    """The whole configuration."""

    model_config = SettingsConfigDict(
        extra="forbid",
        frozen=True,
        env_prefix="SOLIMON_",
        env_nested_delimiter="__",
    )

    reads_environment: ClassVar[bool] = True

    name: str = Field(default="Localized corrosion of a steel plate", min_length=1, max_length=200)
    """Name of the test."""
    site: str = Field(default="", max_length=200)
    """Where the test runs, for readers of its files; stored when the test is created."""
    clock: ClockSettings = ClockSettings()
    schedule: ScheduleSettings = ScheduleSettings()
    rig: RigSettings = RigSettings()
    chain: ChainParameters = ChainParameters()
    plate: PlateParameters = PlateParameters()
    corrosion: CorrosionParameters = CorrosionParameters()
    positions: dict[str, PositionSettings] = Field(default_factory=_default_positions, min_length=1)
    """Monitored places by their short name (letters and digits)."""
    ultrasound: UltrasoundSettings = UltrasoundSettings()
    features: FeatureSettings = FeatureSettings()
    quality: QualitySettings = QualitySettings()
    baseline: BaselineSettings = BaselineSettings()
    novelty: NoveltySettings = NoveltySettings()
    alarms: AlarmSettings = AlarmSettings()
    storage: StorageSettings = StorageSettings()
    web: WebSettings = WebSettings()
    notifications: NotificationSettings = NotificationSettings()
    twin: TwinParameters = TwinParameters()

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Return the sources by precedence: environment, then the given values; no ``.env`` file is read.

        The environment is left out if ``reads_environment`` is false.
        """
        return (env_settings, init_settings) if cls.reads_environment else (init_settings,)

    @model_validator(mode="before")
    @classmethod
    def _fill_positions(cls, values: object) -> object:
        """Return the values with each position's tables filled from the top-level ones of the same name.

        These are chain, plate and corrosion. Without ``positions`` the default ones are used; values of a
        wrong type are left to validation.
        """
        if not isinstance(values, dict):
            return values
        positions = values.get("positions")
        if positions is None:
            positions = {name: _dump_default_position(place) for name, place in _default_positions().items()}
        if not isinstance(positions, dict):
            return values
        filled = {
            name: _inherit_tables(place, values) if isinstance(place, dict) else place
            for name, place in positions.items()
        }
        return {**values, "positions": filled}

    @field_validator("positions")
    @classmethod
    def _check_position_names(cls, positions: dict[str, PositionSettings]) -> dict[str, PositionSettings]:
        """Return the positions; raise ValueError for a name that is not 1 to 16 ASCII letters and digits."""
        for name in positions:
            if not (name.isascii() and name.isalnum() and len(name) <= 16):
                raise ValueError(f"position name {name!r}: use up to 16 ASCII letters and digits")
        return positions

    @model_validator(mode="after")
    def _check_tables_agree(self) -> Self:
        """Return the settings; raise ValueError if tables contradict each other.

        Checked are valid shots, clock, faults of the twin, positions of notification rules, wiring of boards,
        roles of a mixed rig, and the overlap of sets.
        """
        if self.baseline.minimum_valid_shots > self.schedule.shots_per_set:
            raise ValueError(
                f"baseline.minimum_valid_shots is {self.baseline.minimum_valid_shots}; it must be at most "
                f"schedule.shots_per_set = {self.schedule.shots_per_set}"
            )
        if self.clock.kind == "simulated" and not self.rig.simulates_time:
            raise ValueError(
                "clock.kind is 'simulated'; a real rig needs the wall clock: clock.kind = 'wall'"
            )
        if unknown := sorted(set(self.twin.faults) - set(self.list_positions(SOLITARY_WAVE))):
            raise ValueError(
                f"twin.faults.{unknown[0]}: there is no solitary_wave position {unknown[0]!r}; take it out, "
                "or correct the name"
            )
        self._check_minimum_walls()
        self.notifications.require_known_positions(list(self.positions))
        if self.rig.kind == "daqmx":
            self._check_wiring()
        if self.rig.kind == "mixed":
            self.rig.require_role_instruments({name: place.method for name, place in self.positions.items()})
        self._check_set_overlap()
        return self

    def _check_minimum_walls(self) -> None:
        """Raise ValueError for a minimum wall that is not below the initial thickness."""
        for name, place in self.positions.items():
            of_probe = place.method == PULSE_ECHO
            initial_m = self.ultrasound.initial_thickness_m if of_probe else place.plate.thickness_m
            if place.minimum_wall_m is not None and place.minimum_wall_m >= initial_m:
                above = "ultrasound.initial_thickness_m" if of_probe else "the position's plate.thickness_m"
                key = f"positions.{name}.minimum_wall_m = {place.minimum_wall_m}"
                raise ValueError(f"{key} must be below {above} = {initial_m}; correct one of them")

    def _check_set_overlap(self) -> None:
        """Raise ValueError if a set's strikes take more than 99 % of the schedule's shortest interval."""
        transducers = len(self.list_positions(SOLITARY_WAVE))
        # The last strike needs no interval after it.
        strikes = max(0, transducers * self.schedule.shots_per_set - 1)
        takes_s = strikes * self.schedule.shot_interval_s
        shortest_s = min(phase.interval_h for phase in self.schedule.phases) * 3600.0
        if takes_s > FILLED_AT_MOST * shortest_s:
            raise ValueError(
                f"sets overlap: {transducers} transducers, schedule.shots_per_set = "
                f"{self.schedule.shots_per_set} strikes each, one per schedule.shot_interval_s = "
                f"{self.schedule.shot_interval_s:g} s, take {takes_s:g} s. A phase of the schedule has "
                f"one due every {shortest_s:g} s, of which {1.0 - FILLED_AT_MOST:.0%} is left to read the "
                "last record and store it. Choose a longer interval_h or fewer strikes"
            )

    def _check_wiring(self) -> None:
        """Raise ValueError if a position has no input in the board tables, or a wired input no position."""
        assert self.rig.daqmx is not None, "RigSettings asks for it"
        probes = {} if self.rig.niscope is None else self.rig.niscope.probes
        for table, method, wired in (
            ("rig.daqmx.transducers", SOLITARY_WAVE, set(self.rig.daqmx.transducers)),
            ("rig.niscope.probes", PULSE_ECHO, set(probes)),
        ):
            wanted = {name for name, place in self.positions.items() if place.method == method}
            if missing := sorted(wanted - wired):
                raise ValueError(
                    f"position {missing[0]} ({method}) is not wired; add [{table}.{missing[0]}], or take the "
                    "position out of [positions]"
                )
            if unknown := sorted(wired - wanted):
                raise ValueError(
                    f"[{table}.{unknown[0]}] is wired, but [positions] has no {method} position "
                    f"{unknown[0]!r}"
                )

    def false_alarms_per_sensor_year(self) -> float:
        """Return the design false-alarm rate of one transducer, per year: its own, or its share of the total.

        Raises ZeroDivisionError if a total rate is configured without solitary-wave positions.
        """
        of_all = self.alarms.false_alarms_per_year
        if of_all is None:
            return self.alarms.false_alarms_per_sensor_year
        return of_all / sum(place.method == SOLITARY_WAVE for place in self.positions.values())

    def measured(self) -> Tables:
        """Return the settings that affect the data as JSON-ready tables: all keys except `HASHED_OUT`.

        Keys of later versions that keep the earlier behavior are left out, so that stored hashes stay valid.
        """
        values = self.model_dump(mode="json", exclude=dict(HASHED_OUT))
        rig = values["rig"]
        # Keys that came later: where they say what was done before, what was hashed before is hashed still.
        for key, before in (
            ("decides_by", "k_of_n"),
            ("false_alarms_per_sensor_year", 0.2),
            ("confirmation_sets_a_day", AlarmSettings.model_fields["confirmation_sets_a_day"].default),
        ):
            if values["alarms"][key] == before:
                del values["alarms"][key]
        # Keys that came later: absent, what was hashed before is hashed still.
        for place in values["positions"].values():
            if place["minimum_wall_m"] is None:
                del place["minimum_wall_m"]
            if place["waves"] == WaveSettings().model_dump():
                del place["waves"]
        del values["alarms"]["contacts"]  # a telephone number affects no data
        if self.alarms.false_alarms_per_year is None:
            del values["alarms"]["false_alarms_per_year"]
        for key in ("holdoff_s", "watchdogs"):
            if rig["daqmx"] is not None and rig["daqmx"][key] is None:
                del rig["daqmx"][key]
        if self.twin.nuisance == "none":
            del values["twin"]["nuisance"]
        for thinning in values["twin"]["thinning"].values():
            if not thinning["pits_per_edge"]:
                del thinning["pits_per_edge"]
        if self.rig.kind == "mixed":
            rig["instruments"] = {name: item.measured() for name, item in self.rig.instruments.items()}
        else:
            del rig["instruments"], rig["positions"], rig["drive"], rig["air"]
        return values

    def configuration_hash(self) -> str:
        """Return the SHA-256, 64 hexadecimal digits, of the settings that affect the data."""
        return hashlib.sha256(
            json.dumps(self.measured(), sort_keys=True, separators=(",", ":")).encode()
        ).hexdigest()

    def find_wall_limit_m(self, position: str) -> float:
        """Return the wall thickness in m below which the alarm of a probe is raised: the larger limit."""
        of_loss_m = (1.0 - self.alarms.thickness_loss_fraction) * self.ultrasound.initial_thickness_m
        return max(of_loss_m, self.positions[position].minimum_wall_m or 0.0)

    def list_positions(self, method: Method) -> list[str]:
        """Return the names of the positions monitored by a method, in the order of the file."""
        return [name for name, place in self.positions.items() if place.method == method]


def _inherit_tables(place: Mapping[str, object], common: Mapping[str, object]) -> dict[str, object]:
    """Return a position's table whose chain, plate and corrosion are completed by the common tables.

    Values of the position have priority. Tables of a wrong type stay, for validation to reject.
    """
    filled = dict(place)
    for table in ("chain", "plate", "corrosion"):
        above, own = common.get(table, {}), filled.get(table, {})
        if isinstance(above, dict) and isinstance(own, dict):
            filled[table] = {**above, **own}
    return filled


def _dump_default_position(place: PositionSettings) -> dict[str, object]:
    """Return method, label and corrosion size of a default position as a file would give them."""
    return {"method": place.method, "label": place.label, "corrosion": {"size_m": place.corrosion.size_m}}
