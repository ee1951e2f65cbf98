"""The line from strike to alarm, in one process."""

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support.small_experiment import disturbed_rig, rows_of, run
from support.small_experiment import small_settings as half_a_day
from support.stored_files import read_set, set_files
from support.waiting import ended, until

import daq_service.acquisition.taken_set
from analysis.waves.features import extract_features, extract_from_average
from daq_service.archive import FolderArchive
from daq_service.archive.waterfall.tiles import n_bytes
from daq_service.catalogue import RecorderCatalogue, open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, SetRow, ShotRow
from daq_service.cli.forecast import CATALOGUE_BYTES_A_RECORD, built_set_bytes, tile_bytes
from daq_service.cli.offline.twin_line import assessed_sets
from daq_service.errors import RigError, StorageError
from daq_service.rig.open_rig import open_rig
from daq_service.settings.tree import Settings
from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Clock, Rig
from hardware_drivers.measurement import ShotKey
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise

BASELINE_SETS, SETS = 15, 19
SHORT: dict[str, Any] = {
    "schedule": {"phases": [{"until_h": 9.5, "interval_h": 0.5}]},
    "baseline": {"hours": 7.5},
}


def small_settings(**tables: Any) -> Settings:
    """Return settings of the shortest test with an assessed baseline; ``tables`` override them."""
    return half_a_day(**{name: {**SHORT.get(name, {}), **tables.get(name, {})} for name in {*SHORT, *tables}})


def pair_settings(**tables: Any) -> Settings:
    """Return settings with a probe and one transducer: half the time, for repeated runs."""
    settings = small_settings(**tables)
    return settings.model_copy(update={"positions": {name: settings.positions[name] for name in "AB"}})


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    assert run(small_settings(), folder)
    return folder


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the rows of an undisturbed test of a probe and one transducer."""
    folder = tmp_path_factory.mktemp("pair")
    assert run(pair_settings(), folder)
    return rows_of(folder)


def test_the_forecast_is_the_folder_s_size(finished: Path) -> None:
    settings = small_settings()
    files = sum(path.stat().st_size for path in (finished / "sets").iterdir())
    # 5 %: temperature, drop height and thinning wall make pulses, so also their bytes, differ by shot.
    assert SETS * built_set_bytes(settings) == pytest.approx(files, rel=0.05)
    # A record's pretrigger samples may take a cell more.
    assert tile_bytes(settings, SETS) == pytest.approx(n_bytes(finished), rel=0.01)
    # The empty tables, 0.3 MB, weigh more next to ten records per set than in a test of months.
    catalogue = (finished / FILE_NAME).stat().st_size
    assert pytest.approx(catalogue, abs=0.4e6) == CATALOGUE_BYTES_A_RECORD * SETS * 10


def test_every_planned_set_has_its_row_file_and_features(finished: Path) -> None:
    rows = rows_of(finished)
    assert Counter(row.state for row in rows["sets"]) == {"done": 4 * SETS}
    assert sorted(set_files(finished)) == list(range(SETS))
    assert len(rows["shots"]) == SETS * (1 + 3 * 3)
    assert [row.sequence for row in rows["shots"]] == list(range(1, len(rows["shots"]) + 1))
    assert len(rows["set_features"]) == 3 * SETS
    assert len(rows["thickness"]) == SETS


def test_strikes_come_at_the_due_time_and_four_seconds_apart(finished: Path) -> None:
    with open_catalogue(finished) as catalogue:
        (row,) = [row for row in catalogue.rows(SetRow, position="A") if row.set_index == 5]
        times = {
            name: [s.utc_ns for s in catalogue.rows(ShotRow, position=name, set_index=5)] for name in "ABCD"
        }
    due_ns, step_ns = row.due_utc_ns, 4_000_000_000
    assert times["A"] == [due_ns]
    # One transducer after the other, three strikes each.
    for number, name in enumerate("BCD"):
        assert times[name] == [due_ns + (3 * number + k) * step_ns for k in range(3)]


def test_the_catalogue_matches_the_files(finished: Path) -> None:
    """Features computed again from the file alone are those of the catalogue, to the last bit."""
    stored = {row.sequence: row for row in rows_of(finished)["shot_features"]}
    record = read_set(set_files(finished)[7])
    assert len(record.shots) == 9
    for shot in record.shots:
        values = extract_features(shot.waveform).values()
        row = stored[shot.sequence]
        assert {name: getattr(row, name) for name in values} == {
            name: None if np.isnan(value) else value for name, value in values.items()
        }


def test_a_file_matches_the_catalogue_rows_of_its_set(finished: Path) -> None:
    rows = rows_of(finished)
    with h5py.File(set_files(finished)[7]) as file:
        entry = file["entry"]
        assert file.attrs["creator_version"] == entry["program_name"].attrs["version"] == version("solimon")
        shots = {row.sequence: row for row in rows["shots"]}
        found = [row for row in rows["shot_features"] if row.set_index == 7]
        assert entry["features/shot_id"][()].tolist() == [row.sequence for row in found]
        assert entry["features/tof_pp_s"][()].tolist() == [row.tof_pp_s for row in found]
        assert entry["features/tof_pp_s"].attrs["units"] == "s"
        flags = [" ".join(shots[row.sequence].flags) for row in found]
        assert entry["features/flags"].asstr()[()].tolist() == flags
        means = [row.amplitude_ratio for row in rows["set_features"] if row.set_index == 7]
        assert entry["set_features/amplitude_ratio"][()].tolist() == means
        (wall,) = (row.thickness_m for row in rows["thickness"] if row.set_index == 7)
        assert entry["thickness/thickness_m"][()].tolist() == [wall]


def test_a_stored_shot_is_what_simulate_gives_at_its_depth_height_and_tilt(finished: Path) -> None:
    settings = small_settings()
    record = read_set(set_files(finished)[SETS - 1])
    shot = next(shot for shot in record.shots if shot.key.position == "B")
    place = settings.positions["B"]
    again = summarise(
        ShotModel(place.chain, place.plate, place.corrosion).shot(
            depth_fraction=shot.truth["depth_fraction"],
            drop_height_m=shot.truth["drop_height_m"],
            tilt_rad=shot.truth["tilt_rad"],
        )
    )
    # The bound; the same code on the same numbers in fact repeats every bit.
    assert shot.truth["isw_peak_n"] == pytest.approx(again.isw_peak_n, rel=1e-6)
    assert shot.truth["psw_peak_n"] == pytest.approx(again.psw_peak_n, rel=1e-6)
    assert shot.truth["tof_s"] * 1e6 == pytest.approx(again.tof_us, rel=1e-6)
    assert shot.truth["amplitude_ratio"] == pytest.approx(again.amplitude_ratio, rel=1e-6)


def test_a_baseline_is_frozen_once_and_its_sets_get_their_distances(finished: Path) -> None:
    rows = rows_of(finished)
    assert [row.position for row in rows["baselines"]] == ["B", "C", "D"]
    assert {row.n_sets for row in rows["baselines"]} == {BASELINE_SETS}
    of_d = [row for row in rows["verdicts"] if row.position == "D"]
    assert [row.set_index for row in of_d] == list(range(SETS))
    baseline, assessed = of_d[:BASELINE_SETS], of_d[BASELINE_SETS:]
    assert all(row.in_baseline and row.outlier is None for row in baseline)
    # Squared distances of a sample from its own mean sum to (n - 1) p, exactly; 1e-9 is rounding.
    total = sum(row.distance_squared for row in baseline)
    assert total == pytest.approx((BASELINE_SETS - 1) * 5, rel=1e-9)
    assert all(row.outlier is not None and row.limit_f is not None for row in assessed)
    assert all(sum(row.contributions.values()) == pytest.approx(row.distance_squared) for row in assessed)


def test_assessment_without_recorder_and_storage_gives_the_same_result(finished: Path) -> None:
    rows, assessed = rows_of(finished), list(assessed_sets(small_settings(), "B"))
    of_sets = [found.position_result.features[-1] for found in assessed]
    stored = [row for row in rows["set_features"] if row.position == "B"]
    names = {"id": None, "sequence": None}
    assert [replace(row, **names) for row in of_sets] == [replace(row, **names) for row in stored]
    assessments = {row.set_index: row for found in assessed for row in found.position_result.assessments}
    stored_rows = [row for row in rows["verdicts"] if row.position == "B"]
    assert len(stored_rows) == SETS
    for row in stored_rows:
        ours = assessments[row.set_index]
        assert (ours.distance_squared, ours.outlier) == (row.distance_squared, row.outlier)
        assert (ours.limit_f, ours.outlier_paper) == (row.limit_f, row.outlier_paper)


def test_features_may_come_from_the_averaged_record_as_in_the_paper(finished: Path, tmp_path: Path) -> None:
    assert run(small_settings(features={"of_set": "averaged_waveform"}, schedule={"end_h": 2.0}), tmp_path)
    ours = rows_of(tmp_path)
    usual = [row for row in rows_of(finished)["set_features"] if row.set_index < 4]
    assert ours["shot_features"] == [row for row in rows_of(finished)["shot_features"] if row.set_index < 4]
    for averaged, mean in zip(ours["set_features"], usual, strict=True):
        record = read_set(set_files(tmp_path)[averaged.set_index])
        waveforms = [shot.waveform for shot in record.shots if shot.key.position == averaged.position]
        assert averaged.tof_pp_s == extract_from_average(waveforms).tof_pp_s
        # Other quantities, but of the same wave: shots of a set scatter by about one per cent.
        assert averaged.tof_pp_s != mean.tof_pp_s
        assert averaged.tof_pp_s == pytest.approx(mean.tof_pp_s, rel=0.01)
        assert averaged.noise_rms_v < 0.8 * mean.noise_rms_v, "three records are averaged"


def test_another_seed_gives_other_numbers(pair: dict[str, Any], tmp_path: Path) -> None:
    """The same seed gives the same rows: that is in what every disturbed test is compared with, below."""
    assert run(pair_settings(twin={"seed": 2}, schedule={"end_h": 2.0}), tmp_path)
    ours, other = pair["set_features"], rows_of(tmp_path)["set_features"]
    assert len(other) == 4
    assert all(a.tof_pp_s != b.tof_pp_s for a, b in zip(ours, other, strict=False))


def test_disturbances_of_a_shot_are_stored_with_it_and_forecast(tmp_path: Path) -> None:
    settings = pair_settings(twin={"nuisance": "plant"}, schedule={"end_h": 1.0})
    assert run(settings, tmp_path)
    sizes = [path.stat().st_size for path in (tmp_path / "sets").iterdir()]
    # As without nuisance.
    assert built_set_bytes(settings) * len(sizes) == pytest.approx(sum(sizes), rel=0.05)
    (struck,) = (found for found in assessed_sets(settings, "B") if found.due.set_index == 1)
    stored = [shot for shot in read_set(set_files(tmp_path)[1]).shots if shot.key.position == "B"]
    assert [dict(shot.truth) for shot in stored] == [dict(shot.truth) for shot in struck.shots]
    assert sum(name.startswith("nuisance_") for name in stored[0].truth) == 12 + 2 * 9


@contextmanager
def _stopping_rig(stop: threading.Event, key: ShotKey) -> Iterator[Any]:
    def disturb(taken: ShotKey, acquired: Acquired) -> Acquired:
        if taken == key:
            stop.set()
        return acquired

    yield disturbed_rig(disturb)


def test_a_stop_between_sets_changes_no_row(pair: dict[str, Any], tmp_path: Path) -> None:
    """Stopped after a set's last shot, then started again: as if nothing had happened."""
    for last in (5, BASELINE_SETS - 1, BASELINE_SETS + 1):
        stop = threading.Event()
        with _stopping_rig(stop, ShotKey(position="B", set_index=last, shot_index=2)) as rig:
            assert not run(pair_settings(), tmp_path, rig=rig, stop=stop)
    assert run(pair_settings(), tmp_path)
    assert rows_of(tmp_path) == pair


def test_a_stop_within_a_set_costs_no_strike(pair: dict[str, Any], tmp_path: Path) -> None:
    """The set stays open; a restart takes the missing strikes only, and changes no row."""
    for last in (0, 4):
        stop = threading.Event()
        with _stopping_rig(stop, ShotKey(position="B", set_index=last, shot_index=1)) as rig:
            assert not run(pair_settings(), tmp_path, rig=rig, stop=stop)
        with open_catalogue(tmp_path) as catalogue:
            assert [row for row in catalogue.rows(SetRow) if row.set_index >= last] == []
        (opened,) = FolderArchive(tmp_path).open_sets().values()
        assert [(item.key.position, item.key.shot_index) for item in opened.records] == [
            ("A", 0),
            ("B", 0),
            ("B", 1),
        ]
    struck = []

    def count(key: ShotKey, acquired: Acquired) -> Acquired:
        struck.append((key.set_index, key.shot_index))
        return acquired

    assert run(pair_settings(), tmp_path, rig=disturbed_rig(count))
    assert struck[:4] == [(4, 2), (5, 0), (5, 1), (5, 2)]
    assert rows_of(tmp_path) == pair
    assert list((tmp_path / "journal").iterdir()) == []


class _KilledError(BaseException):
    """Substitute for SIGKILL, which no code may catch to clean up."""


@pytest.mark.parametrize(
    "killed_at",
    [BASELINE_SETS - 1, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 3, BASELINE_SETS))],
)
@pytest.mark.parametrize(
    "boundary",
    [
        "after the file",
        *(pytest.param(at, marks=pytest.mark.slow) for at in ("before the file", "after the rows")),
    ],
)
def test_a_kill_at_any_boundary_of_a_set_changes_no_row(
    pair: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, boundary: str, killed_at: int
) -> None:
    store_set, commit_set = FolderArchive.store_set, RecorderCatalogue.commit_set

    def killing_store(self: FolderArchive, record: Any) -> Any:
        if record.set_index != killed_at:
            return store_set(self, record)
        if boundary == "before the file":
            raise _KilledError
        return store_set(self, record)

    def killing_commit(self: RecorderCatalogue, commit: Any) -> Any:
        if not commit.sets or commit.sets[0].set_index != killed_at:
            return commit_set(self, commit)
        if boundary == "after the file":
            raise _KilledError
        committed = commit_set(self, commit)
        if boundary == "after the rows":
            raise _KilledError
        return committed

    with monkeypatch.context() as patch:
        patch.setattr(FolderArchive, "store_set", killing_store)
        patch.setattr(RecorderCatalogue, "commit_set", killing_commit)
        with pytest.raises(_KilledError):
            run(pair_settings(), tmp_path)
    if boundary == "before the file":
        reported = {row.set_index for row in rows_of(tmp_path)["sets"]}
        assert killed_at not in reported, "nothing may be said of a set whose file is not durable"
    assert run(pair_settings(), tmp_path)
    assert rows_of(tmp_path) == pair
    assert sorted(set_files(tmp_path)) == list(range(SETS))
    # Its rows come first, and its file has their results.
    assert read_set(set_files(tmp_path)[killed_at]).results.keys() == {
        "features",
        "set_features",
        "thickness",
    }


def test_a_stored_set_is_not_struck_again_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killing_commit(self: RecorderCatalogue, commit: Any) -> Any:
        if commit.sets and commit.sets[0].set_index == 3:
            raise _KilledError
        return commit_set(self, commit)

    def note(key: ShotKey, acquired: Acquired) -> Acquired:
        struck.append(key.set_index)
        return acquired

    commit_set = RecorderCatalogue.commit_set
    struck: list[int] = []
    with monkeypatch.context() as patch:
        patch.setattr(RecorderCatalogue, "commit_set", killing_commit)
        with pytest.raises(_KilledError):
            run(pair_settings(), tmp_path)
    assert run(pair_settings(schedule={"end_h": 3.0}), tmp_path, rig=disturbed_rig(note))
    assert sorted(set(struck)) == [4, 5], "set 3 is in its file: it is judged, not taken again"


THINS_AFTER_THE_BASELINE = {"B": {"onset_h": 7.5, "reference_h": 9.5, "depth_fraction": 0.6}}


@pytest.mark.slow
def test_an_alarm_builds_up_across_a_restart(tmp_path: Path) -> None:
    """Two outliers before the stop and one after it are three of five."""
    settings = pair_settings(twin={"thinning": THINS_AFTER_THE_BASELINE}, alarms={"decides_by": "k_of_n"})
    assert run(settings, tmp_path / "whole")
    whole = rows_of(tmp_path / "whole")
    (alarm,) = [row for row in whole["alarms"] if row.position == "B"]
    assert alarm.kind == "wall_change"
    assert alarm.proof["limit"] == pytest.approx(whole["baselines"][0].limit_f)
    outliers = [row.set_index for row in whole["verdicts"] if row.position == "B" and row.outlier]
    assert alarm.raised_set_index == outliers[2]
    for last in outliers[:2]:
        stop = threading.Event()
        with _stopping_rig(stop, ShotKey(position="B", set_index=last, shot_index=2)) as rig:
            assert not run(settings, tmp_path / "stopped", rig=rig, stop=stop)
    assert run(settings, tmp_path / "stopped")
    assert rows_of(tmp_path / "stopped") == whole


def test_a_missed_strike_leaves_a_partial_set_with_its_cause(tmp_path: Path) -> None:
    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        if (key.position, key.set_index, key.shot_index) == ("B", 2, 1):
            raise AcquisitionTimeoutError("no trigger within 5 s")
        return acquired

    assert run(small_settings(schedule={"end_h": 2.0}), tmp_path, rig=disturbed_rig(disturb))
    with open_catalogue(tmp_path) as catalogue:
        (row,) = [row for row in catalogue.rows(SetRow, position="B") if row.set_index == 2]
        shots = catalogue.rows(ShotRow, position="B", set_index=2)
    assert (row.state, row.n_taken, row.n_valid) == ("partial", 2, 2)
    assert row.cause == "2 missed: no trigger within 5 s"  # the strike and its repetition
    assert [shot.shot_index for shot in shots] == [0, 2]


def test_a_set_without_any_record_is_missed_and_has_no_file(tmp_path: Path) -> None:
    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        raise AcquisitionTimeoutError("no trigger within 5 s")

    settings = small_settings(
        schedule={"end_h": 1.0},
        positions={"B": {"method": "solitary_wave"}, "D": {"method": "solitary_wave"}},
    )
    settings = settings.model_copy(update={"positions": {"B": settings.positions["B"]}})
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    with open_catalogue(tmp_path) as catalogue:
        rows = catalogue.rows(SetRow)
        assert catalogue.counts()["missed_sets"] == 2
    assert [row.state for row in rows] == ["missed", "missed"]
    assert all("no trigger within 5 s" in row.cause for row in rows)
    assert set_files(tmp_path) == {}


def test_a_rig_that_can_never_work_stops_the_test_with_what_was_taken(tmp_path: Path) -> None:
    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        if (key.position, key.set_index, key.shot_index) == ("C", 0, 2):
            orders.append(_order(tmp_path, "resume"))
            raise ConfigurationError("the range is refused")
        return acquired

    orders: list[int] = []
    with pytest.raises(RigError, match="the range is refused") as failure:
        run(small_settings(), tmp_path, rig=disturbed_rig(disturb))
    assert failure.value.exit_code == 3
    state, words = _answer(tmp_path, orders[0])
    assert (state, "the recorder has ended" in words) == ("expired", True)
    assert len(read_set(set_files(tmp_path)[0]).shots) == 5
    with open_catalogue(tmp_path) as catalogue:
        states = {row.position: row.state for row in catalogue.rows(SetRow)}
    assert states == {"A": "done", "B": "done", "C": "partial", "D": "missed"}


def test_a_hole_disables_its_transducer_and_the_others_continue(tmp_path: Path) -> None:
    thinning = {"B": {"onset_h": 0.0, "reference_h": 3.0, "depth_fraction": 0.5, "hole_h": 3.0}}
    assert run(small_settings(twin={"thinning": thinning}, schedule={"end_h": 5.0}), tmp_path)
    with open_catalogue(tmp_path) as catalogue:
        states = [row.state for row in catalogue.rows(SetRow, position="B")]
        others = {row.state for row in catalogue.rows(SetRow, position="D")}
        (alarm,) = catalogue.rows(AlarmRow, position="B")
        counts = catalogue.counts()
    # The hole opens at 3.0 h, the set due then; the second silent one retires the transducer.
    assert states == ["done"] * 7 + ["retired"] * 3
    assert others == {"done"}
    assert (alarm.kind, alarm.severity, alarm.raised_h) == ("hole", "critical", 3.5)
    assert counts["missed_sets"] == 0
    assert run(small_settings(twin={"thinning": thinning}, schedule={"end_h": 6.0}), tmp_path)
    with open_catalogue(tmp_path) as catalogue:
        assert catalogue.rows(SetRow, position="B")[-1].state == "retired", "a restart must not strike again"


def test_a_shot_that_cannot_be_analysed_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(waveform: Any) -> Any:
        calls.append(waveform)
        if len(calls) == 4:
            raise ZeroDivisionError("a fault of the analysis")
        return extract_features(waveform)

    calls: list[Any] = []
    monkeypatch.setattr(daq_service.acquisition.taken_set, "extract_features", failing)
    assert run(small_settings(schedule={"end_h": 1.0}), tmp_path)
    shots = rows_of(tmp_path)["shots"]
    flagged = [shot for shot in shots if "not_analysed" in shot.flags]
    assert [(shot.position, shot.shot_index, shot.valid) for shot in flagged] == [("C", 0, False)]
    assert len(read_set(set_files(tmp_path)[0]).shots) == 9


def test_a_folder_of_another_configuration_is_refused_untouched(tmp_path: Path) -> None:
    assert run(pair_settings(schedule={"end_h": 1.0}), tmp_path)
    before = rows_of(tmp_path)
    with pytest.raises(StorageError, match="another folder"):
        run(pair_settings(twin={"seed": 99}), tmp_path)
    assert rows_of(tmp_path) == before


class _LateClock:
    """Wall clock on which the experiment has been running, unattended, for some hours."""

    def __init__(self, clock: Clock, late_ns: int) -> None:
        self._clock = clock
        self._late_ns = late_ns

    def utc_ns(self) -> int:
        return self._clock.utc_ns() + self._late_ns

    def mono_ns(self) -> int:
        return self.utc_ns()

    def wait_until(self, utc_ns: int, idle: Any) -> bool:
        return self._clock.wait_until(utc_ns - self._late_ns, idle)


def test_sets_due_without_a_recorder_get_gap_rows_with_the_cause(tmp_path: Path) -> None:
    assert run(small_settings(schedule={"end_h": 1.0}), tmp_path)

    @contextmanager
    def late_rig(settings: Settings, clock: Clock, epoch_utc_ns: int) -> Iterator[Rig]:
        # 1.03 h are over already (the last set's end): now it is 3.2 h.
        late = _LateClock(clock, round(2.17 * 3.6e12))
        with open_rig(settings, late, epoch_utc_ns) as rig:
            yield replace(rig, clock=late)

    assert run(
        small_settings(schedule={"end_h": 4.0}),
        tmp_path,
        rig=late_rig,
        restart_reason="was killed by signal 9",
    )
    with open_catalogue(tmp_path) as catalogue:
        rows = catalogue.rows(SetRow, position="D")
        gaps = [event for event in catalogue.events_after(0, ["sets"]) if event.kind == "set_missed"]
    assert [row.state for row in rows] == ["done"] * 2 + ["missed"] * 3 + ["done"] * 3
    assert {row.cause for row in rows[2:5]} == {"the recorder was killed by signal 9"}
    # The set due at 3.0 h is taken late, at 3.2 h: its time is not over before the next one's.
    assert rows[5].started_utc_ns - rows[5].due_utc_ns > 0.1 * 3.6e12
    with open_catalogue(tmp_path) as catalogue:
        late = [shot.utc_ns for shot in catalogue.rows(ShotRow, position="D", set_index=5)]
    assert np.diff(late).tolist() == [4_000_000_000] * 2, "a late set is not taken in a hurry"
    assert len(gaps) == 3 * 4


def _order(folder: Path, kind: str, **arguments: Any) -> int:
    with open_catalogue(folder) as catalogue:
        return catalogue.add_command("ann", kind, arguments)


def _starts(folder: Path) -> int:
    with open_catalogue(folder) as catalogue:
        return sum(event.kind == "recorder_started" for event in catalogue.events_after(0, ["service"]))


def _answer(folder: Path, command_id: int) -> tuple[str, str]:
    with open_catalogue(folder) as catalogue:
        row = catalogue.command(command_id)
    assert row is not None
    return row.state, row.result


def test_commands_are_executed_or_rejected_with_the_reason(tmp_path: Path) -> None:
    thinning = {"B": {"onset_h": 0.0, "reference_h": 1.0, "depth_fraction": 0.5, "hole_h": 1.0}}
    settings = pair_settings(twin={"thinning": thinning}, schedule={"end_h": 3.0})
    assert run(settings, tmp_path)
    paced = pair_settings(twin={"thinning": thinning}, schedule={"end_h": 4.0}, clock={"pace_h_per_s": 1e-4})
    # It lingers, since "finish now" may end the test before "stop" is given.
    recorder = threading.Thread(target=run, args=(paced, tmp_path), kwargs={"linger": True})
    recorder.start()
    until(lambda: _starts(tmp_path) == 2, "the second start")
    orders = {
        "unknown": _order(tmp_path, "self_destruct"),
        "seen": _order(tmp_path, "acknowledge_alarm", alarm_id=1, note="plate inspected"),
        "again": _order(tmp_path, "acknowledge_alarm", alarm_id=1),
        "absent": _order(tmp_path, "acknowledge_alarm", alarm_id=99),
        "finish": _order(tmp_path, "finish_now"),
        "stop": _order(tmp_path, "stop"),
    }
    ended(recorder, "the stop")
    answers = {name: _answer(tmp_path, order) for name, order in orders.items()}
    assert answers["unknown"][0] == "refused"
    assert "unknown order" in answers["unknown"][1]
    assert answers["seen"] == ("done", "acknowledged")
    assert answers["again"][0] == answers["absent"][0] == "refused"
    assert answers["finish"][0] == answers["stop"][0] == "done"
    with open_catalogue(tmp_path) as catalogue:
        alarm = catalogue.alarm(1)
    assert alarm is not None
    assert (alarm.state, alarm.acknowledged_by, alarm.note) == (
        "acknowledged",
        "ann",
        "plate inspected",
    )


def test_a_short_baseline_gives_no_limit_and_its_reason(tmp_path: Path) -> None:
    assert run(pair_settings(baseline={"hours": 3.0}, schedule={"end_h": 3.5}), tmp_path)
    with open_catalogue(tmp_path) as catalogue:
        baseline = catalogue.baseline("B")
        assessment = catalogue.rows(AssessmentRow, position="B")[-1]
    assert baseline is not None
    assert (baseline.limit_f, baseline.limit_paper, baseline.n_sets) == (None, None, 6)
    assert "6 sets" in baseline.limit_reason
    assert (assessment.outlier, assessment.distance_squared) == (None, None)
    assert assessment.reason == baseline.limit_reason


def test_a_test_carried_on_for_longer_has_the_same_rows(pair: dict[str, Any], tmp_path: Path) -> None:
    assert run(pair_settings(schedule={"end_h": 4.0}), tmp_path)
    assert run(pair_settings(), tmp_path)
    assert rows_of(tmp_path) == pair
