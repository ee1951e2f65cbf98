"""Poor strikes are repeated, silent transducers retire, a rig that is gone costs sets and not the test."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.served_web import served
from support.small_experiment import RigOpener, disturbed_rig, rows_of, small_settings
from support.small_experiment import run as run_experiment
from support.stored_files import read_set, read_waveform, set_files

from analysis.waves.features import ALL_FEATURE_NAMES
from daq_service.catalogue import RecorderCatalogue, open_catalogue
from daq_service.catalogue.rows import AlarmRow, FeatureRow, SetRow, ShotRow
from daq_service.cli.status.command import run_status
from daq_service.cli.status.facts import describe_status
from daq_service.clock import parse_utc
from daq_service.errors import RigError
from daq_service.settings.tree import Settings
from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
)
from hardware_drivers.instruments import Acquired, Clock, Rig
from hardware_drivers.measurement import ShotKey
from hardware_drivers.nanoseconds import NS_PER_H

EPOCH_NS = parse_utc("2024-01-01T00:00:00Z")
STEP_NS = 4_000_000_000
NO_TRIGGER = "no trigger within 5 s"

Disturb = Callable[[ShotKey, Acquired], Acquired]
Order = tuple[float, str, dict[str, Any]]

run = partial(run_experiment, listen_every_s=0.0)
"""Simulated hours pass in milliseconds: orders are heard at every look."""


def clipped(acquired: Acquired) -> Acquired:
    """Return the same strike at a range that is too small for its incident wave."""
    waveform = acquired.waveform
    low, high = waveform.calibration.full_scale_counts
    counts = np.clip(waveform.counts * (1.1 * high / waveform.counts.max()), low, high)
    return replace(acquired, waveform=replace(waveform, counts=counts.astype(waveform.counts.dtype)))


def noisy(acquired: Acquired) -> Acquired:
    """Add white noise of 0.5 V to an incident wave of some 2.5 V: 14 dB, where a shot is noisy below 17."""
    waveform = acquired.waveform
    slope = float(waveform.calibration.coefficients_v[1])
    noise = np.random.default_rng(5).normal(0.0, 0.5 / slope, waveform.counts.size)
    counts = np.clip(waveform.counts + noise, -30_000, 30_000).astype(waveform.counts.dtype)
    return replace(acquired, waveform=replace(waveform, counts=counts))


def untouched(key: ShotKey, acquired: Acquired) -> Acquired:
    return acquired


def first_attempt(
    position: str, set_index: int, shot_index: int, change: Callable[[Acquired], Acquired]
) -> Disturb:
    """Disturb the first strike of one shot, not its repetition."""
    wanted = ShotKey(position=position, set_index=set_index, shot_index=shot_index)
    return lambda key, acquired: change(acquired) if key == wanted else acquired


def silent(position: str, from_set: int = 0, until_set: int = 10_000) -> Disturb:
    """Disturb a position so that nothing triggers."""

    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        if key.position == position and from_set <= key.set_index < until_set:
            raise AcquisitionTimeoutError(NO_TRIGGER)
        return acquired

    return disturb


def missed(acquired: Acquired) -> Acquired:
    raise AcquisitionTimeoutError(NO_TRIGGER)


class OrderingClock:
    """Clock of the recorder, with an operator who writes commands at chosen hours of the test.

    Late ones come when the hour is reached: the recorder hears them at its next look.
    """

    def __init__(self, clock: Clock, folder: Path, orders: Sequence[Order], late: bool) -> None:
        self._clock = clock
        self._folder = folder
        self._orders = list(orders)
        self._late = late

    def utc_ns(self) -> int:
        return self._clock.utc_ns()

    def mono_ns(self) -> int:
        return self._clock.mono_ns()

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        reached = self._late and self._clock.wait_until(utc_ns, idle)
        while self._orders and utc_ns >= EPOCH_NS + round(self._orders[0][0] * NS_PER_H):
            _, kind, arguments = self._orders.pop(0)
            with open_catalogue(self._folder) as catalogue:
                catalogue.add_command("ann", kind, arguments)
        return reached if self._late else self._clock.wait_until(utc_ns, idle)


def ordering_rig(
    folder: Path, orders: Sequence[Order], disturb: Disturb = untouched, *, late: bool = False
) -> RigOpener:
    """Return a disturbed twin whose operator gives the commands ``orders``: hour, kind, arguments."""

    @contextmanager
    def opener(settings: Settings, clock: Clock, epoch_utc_ns: int) -> Iterator[Rig]:
        with disturbed_rig(disturb)(settings, clock, epoch_utc_ns) as rig:
            yield replace(rig, clock=OrderingClock(rig.clock, folder, orders, late))

    return opener


def sets_of(folder: Path, position: str) -> list[SetRow]:
    with open_catalogue(folder) as catalogue:
        return sorted(catalogue.rows(SetRow, position=position), key=lambda row: row.set_index)


def shots_of(folder: Path, position: str, set_index: int) -> list[ShotRow]:
    with open_catalogue(folder) as catalogue:
        return catalogue.rows(ShotRow, position=position, set_index=set_index)


def alarms_of(folder: Path) -> dict[tuple[str | None, str], AlarmRow]:
    with open_catalogue(folder) as catalogue:
        return {(row.position, row.kind): row for row in catalogue.rows(AlarmRow)}


def answers(folder: Path) -> list[tuple[str, str, str]]:
    """Return kind, state and result of every command."""
    with open_catalogue(folder) as catalogue:
        found = []
        while (row := catalogue.command(len(found) + 1)) is not None:
            found.append((row.kind, row.state, row.result))
        return found


def only(names: str, settings: Settings) -> Settings:
    """Return settings of these positions only: each costs test time."""
    return settings.model_copy(update={"positions": {name: settings.positions[name] for name in names}})


def two_hours(**tables: Any) -> Settings:
    return small_settings(schedule={"end_h": 2.0}, **tables)


# Repeated strikes ------------------------------------------------------------------------------


def test_a_missed_strike_is_repeated_and_the_set_is_done(tmp_path: Path) -> None:
    assert run(only("BC", two_hours()), tmp_path, rig=disturbed_rig(first_attempt("B", 2, 1, missed)))
    row = sets_of(tmp_path, "B")[2]
    assert (row.state, row.cause) == ("done", None)
    assert (row.n_taken, row.n_valid, row.n_missed, row.n_restrikes) == (3, 3, 1, 1)
    shots = shots_of(tmp_path, "B", 2)
    assert [(shot.shot_index, shot.attempt, shot.outcome) for shot in shots] == [
        (0, 0, "accepted"),
        (1, 1, "accepted"),
        (2, 0, "accepted"),
    ]
    # The repetition takes the next interval, and what comes after it moves by one.
    due_ns = row.due_utc_ns
    assert [shot.utc_ns - due_ns for shot in shots] == [0, 2 * STEP_NS, 3 * STEP_NS]
    assert shots_of(tmp_path, "C", 2)[0].utc_ns - due_ns == 4 * STEP_NS
    (missed_shot,) = read_set(set_files(tmp_path)[2]).missed
    assert (missed_shot.key, missed_shot.cause, missed_shot.reason) == (
        ShotKey(position="B", set_index=2, shot_index=1),
        NO_TRIGGER,
        "no_trigger",
    )


def test_a_clipped_shot_is_stored_and_superseded_by_its_repetition(tmp_path: Path) -> None:
    settings = only("C", two_hours())
    assert run(settings, tmp_path, rig=disturbed_rig(first_attempt("C", 1, 2, clipped)))
    row = sets_of(tmp_path, "C")[1]
    assert (row.state, row.n_taken, row.n_valid, row.n_restrikes) == ("done", 4, 3, 1)
    shots = shots_of(tmp_path, "C", 1)
    assert [(shot.shot_index, shot.attempt, shot.outcome) for shot in shots] == [
        (0, 0, "accepted"),
        (1, 0, "accepted"),
        (2, 0, "superseded"),
        (2, 1, "accepted"),
    ]
    assert (shots[2].flags, shots[2].valid) == (["clipped"], False)
    record = read_set(set_files(tmp_path)[1])
    assert record.outcomes == {shots[2].sequence: "superseded"}
    stored = {shot.sequence: shot.waveform for shot in record.shots}
    accepted = stored[shots[3].sequence]
    assert stored[shots[2].sequence].clipped
    assert not accepted.clipped
    assert read_waveform(set_files(tmp_path)[1], "C", 2).counts.tobytes() == accepted.counts.tobytes()
    with served(settings, tmp_path) as service, service.client() as api:
        answer = api.get("/api/v1/waveforms/C/1/2").json()
    assert (answer["sequence"], answer["flags"], answer["quality"]) == (shots[3].sequence, [], "good")
    assert answer["voltage_v"] == accepted.volts().tolist()


def test_a_sets_feature_is_the_mean_of_its_accepted_shots(tmp_path: Path) -> None:
    """A noisy shot is no invalid one: only its outcome keeps it out of the mean."""
    assert run(only("C", two_hours()), tmp_path, rig=disturbed_rig(first_attempt("C", 1, 2, noisy)))
    with open_catalogue(tmp_path) as catalogue:
        shots = catalogue.rows(ShotRow, position="C", set_index=1)
        rows = catalogue.rows(FeatureRow, position="C", scope="shot", set_index=1)
        (of_set,) = catalogue.rows(FeatureRow, position="C", scope="set", set_index=1)
    assert [(shot.flags, shot.outcome, shot.valid) for shot in shots[2:]] == [
        (["noisy"], "superseded", True),
        ([], "accepted", True),
    ]
    accepted = {shot.sequence for shot in shots if shot.outcome == "accepted"}
    assert (of_set.n_valid, of_set.quality) == (3, "good")
    for name in ALL_FEATURE_NAMES:
        values = [getattr(row, name) for row in rows if row.sequence in accepted]
        if None not in values:
            # The mean of three in another order: rounding only.
            assert getattr(of_set, name) == pytest.approx(sum(values) / 3, rel=1e-12), name
    assert len(rows) == 4, "the superseded shot keeps its features"


def test_of_two_poor_attempts_the_better_one_counts(tmp_path: Path) -> None:
    """Noisy, then clipped: the first one can be used, so it does."""

    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        if (key.position, key.set_index, key.shot_index) != ("B", 0, 0):
            return acquired
        return clipped(acquired) if key.attempt else noisy(acquired)

    settings = only("B", two_hours())
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    shots = shots_of(tmp_path, "B", 0)
    assert [(shot.attempt, shot.outcome) for shot in shots[:2]] == [(0, "accepted"), (1, "superseded")]
    with served(settings, tmp_path) as service, service.client() as api:
        answer = api.get("/api/v1/waveforms/B/0/0").json()
    assert (answer["sequence"], answer["quality"]) == (shots[0].sequence, "suspect")
    expected = read_waveform(set_files(tmp_path)[0], "B", 0)
    assert answer["voltage_v"] == expected.volts().tolist()
    assert not expected.clipped


@pytest.mark.slow
def test_the_budget_of_a_set_is_kept_for_each_transducer(tmp_path: Path) -> None:
    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        tried.append(key)
        if key.set_index == 1 and key.position in "BC":
            raise AcquisitionTimeoutError(NO_TRIGGER)
        return acquired

    tried: list[ShotKey] = []
    settings = two_hours(quality={"restrikes_per_set": 2})
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    for position in "BC":
        keys = [key for key in tried if key.position == position and key.set_index == 1]
        assert [(key.shot_index, key.attempt) for key in keys] == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)]
        row = sets_of(tmp_path, position)[1]
        assert (row.state, row.n_missed, row.n_restrikes) == ("missed", 5, 2)
        assert row.cause == f"5 missed: {NO_TRIGGER}"
    assert sets_of(tmp_path, "D")[1].n_restrikes == 0


@pytest.mark.slow
def test_without_a_budget_nothing_is_struck_twice(tmp_path: Path) -> None:
    settings = two_hours(quality={"restrikes_per_set": 0})
    assert run(settings, tmp_path, rig=disturbed_rig(first_attempt("B", 2, 1, missed)))
    row = sets_of(tmp_path, "B")[2]
    assert (row.state, row.n_taken, row.n_missed, row.n_restrikes) == ("partial", 2, 1, 0)


def test_a_flag_that_is_not_configured_is_not_repeated(tmp_path: Path) -> None:
    settings = only("C", two_hours(quality={"restrike_flags": ["missed"]}))
    assert run(settings, tmp_path, rig=disturbed_rig(first_attempt("C", 1, 2, clipped)))
    row = sets_of(tmp_path, "C")[1]
    assert (row.n_taken, row.n_valid, row.n_restrikes) == (3, 2, 0)


class _KilledError(BaseException):
    """Substitute for SIGKILL, which no code may catch to clean up."""


def test_rows_made_from_an_orphaned_file_are_those_of_the_recorder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Missed, superseded and lost shots, and the trouble that ended the set: all are in the file."""

    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        if key.set_index == 1 and key.attempt == 0 and (key.position, key.shot_index) == ("B", 0):
            raise AcquisitionTimeoutError(NO_TRIGGER)
        if key.set_index == 1 and key.attempt == 0 and (key.position, key.shot_index) == ("B", 1):
            return clipped(acquired)
        if key.set_index == 1 and key.position == "C":
            raise ConnectionLostError("the board does not answer")
        return acquired

    def killing(self: RecorderCatalogue, commit: Any) -> Any:
        if commit.sets and commit.sets[0].set_index == 1:
            raise _KilledError
        return commit_set(self, commit)

    assert run(only("ABC", two_hours()), tmp_path / "whole", rig=disturbed_rig(disturb))
    whole = rows_of(tmp_path / "whole")
    assert {row.kind for row in whole["alarms"]} == {"rig_unavailable"}
    commit_set = RecorderCatalogue.commit_set
    with monkeypatch.context() as patch:
        patch.setattr(RecorderCatalogue, "commit_set", killing)
        with pytest.raises(_KilledError):
            run(only("ABC", two_hours()), tmp_path / "killed", rig=disturbed_rig(disturb))
    assert run(only("ABC", two_hours()), tmp_path / "killed")
    assert rows_of(tmp_path / "killed") == whole


# Transducers that give nothing ---------------------------------------------------------------------

SILENT = {"no_data_sets": 2, "retire_after_sets": 4}


SILENT_FROM_SET_1 = silent("B", from_set=1)


def with_a_silent_one() -> Settings:
    return only("BD", small_settings(schedule={"end_h": 4.0}, quality=SILENT))


@pytest.fixture(scope="module")
def silent_one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a test whose transducer B becomes silent; return its folder."""
    folder = tmp_path_factory.mktemp("silent")
    assert run(with_a_silent_one(), folder, rig=disturbed_rig(SILENT_FROM_SET_1))
    return folder


def test_a_silent_transducer_raises_no_data_and_is_then_disabled(silent_one: Path) -> None:
    states = [row.state for row in sets_of(silent_one, "B")]
    assert states == ["done"] + ["missed"] * 4 + ["retired"] * 3
    assert {row.state for row in sets_of(silent_one, "D")} == {"done"}
    alarms = alarms_of(silent_one)
    assert set(alarms) == {("B", "no_data"), ("B", "retired")}
    assert alarms["B", "no_data"].raised_set_index == 2, "the second silent set"
    assert alarms["B", "retired"].raised_set_index == 4, "the fourth silent set"
    assert alarms["B", "retired"].severity == "high"
    assert "strikes no more" in alarms["B", "retired"].message
    assert sets_of(silent_one, "B")[-1].cause == alarms["B", "retired"].message


@pytest.mark.parametrize("last", [2, 4, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 3))])
def test_a_restart_between_silent_sets_changes_no_row(silent_one: Path, tmp_path: Path, last: int) -> None:
    stop = threading.Event()

    def stopping(key: ShotKey, acquired: Acquired) -> Acquired:
        if key == ShotKey(position="D", set_index=last, shot_index=2):
            stop.set()
        return SILENT_FROM_SET_1(key, acquired)

    settings = with_a_silent_one()
    assert not run(settings, tmp_path, rig=disturbed_rig(stopping), stop=stop)
    assert run(settings, tmp_path, rig=disturbed_rig(SILENT_FROM_SET_1))
    assert rows_of(tmp_path) == rows_of(silent_one)


def test_a_valid_shot_in_between_restarts_the_count(tmp_path: Path) -> None:
    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        if key.position == "B" and key.set_index != 2:
            raise AcquisitionTimeoutError(NO_TRIGGER)
        return acquired

    settings = only("BD", small_settings(schedule={"end_h": 3.0}, quality=SILENT))
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    assert [row.state for row in sets_of(tmp_path, "B")] == [
        "missed",
        "missed",
        "done",
        "missed",
        "missed",
        "missed",
    ]
    assert ("B", "retired") not in alarms_of(tmp_path)


@pytest.mark.parametrize("restart", [pytest.param(False, marks=pytest.mark.slow), True])
def test_an_enabled_transducer_strikes_again_and_its_count_restarts(tmp_path: Path, restart: bool) -> None:
    """Retired by sets 0 to 3, put back right after, silent again: four more sets, not one."""
    settings = only("BD", small_settings(schedule={"end_h": 5.0}, quality=SILENT))
    stop = threading.Event()
    quiet = silent("B")

    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        # Before any set is stored as retired: only the reset of the alarm shows that it was enabled.
        if restart and key == ShotKey(position="D", set_index=4, shot_index=2):
            stop.set()
        return quiet(key, acquired)

    orders: list[Order] = [(2.4, "enable", {"position": "B", "note": "new coil"})]
    rig = ordering_rig(tmp_path, orders, disturb)
    assert run(settings, tmp_path, rig=rig, stop=stop) is not restart
    if restart:
        assert run(settings, tmp_path, rig=disturbed_rig(quiet))
    assert answers(tmp_path) == [("enable", "done", "B strikes again from the next set")]
    states = [row.state for row in sets_of(tmp_path, "B")]
    assert states == ["missed"] * 8 + ["retired"] * 2
    with open_catalogue(tmp_path) as catalogue:
        first, second = (row for row in catalogue.rows(AlarmRow, position="B") if row.kind == "retired")
    assert (first.state, first.acknowledged_by, first.note) == ("normal", "ann", "new coil")
    assert (second.state, second.raised_set_index) == ("unacknowledged", 7)


@pytest.mark.parametrize("restart", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_dismissed_hole_needs_two_silent_sets_again(tmp_path: Path, restart: bool) -> None:
    """The chain had lost contact: put right after set 6, and silent again at once."""
    thinning = {"B": {"onset_h": 0.0, "reference_h": 3.0, "depth_fraction": 0.5, "hole_h": 3.0}}
    settings = only("BD", small_settings(twin={"thinning": thinning}, schedule={"end_h": 6.0}))
    orders: list[Order] = [(3.9, "enable", {"position": "B", "note": "contact was open"})]
    if restart:
        orders.append((3.9, "stop", {}))
    assert run(settings, tmp_path, rig=ordering_rig(tmp_path, orders)) is not restart
    if restart:
        assert run(settings, tmp_path)
    # Sets 5 and 6 make the hole, set 7 is the first one after the reinstatement.
    assert [row.state for row in sets_of(tmp_path, "B")] == ["done"] * 9 + ["retired"] * 3
    with open_catalogue(tmp_path) as catalogue:
        first, second = (row for row in catalogue.rows(AlarmRow, position="B") if row.kind == "hole")
    assert (first.state, second.raised_set_index) == ("normal", 8)


@pytest.mark.slow
def test_an_operator_disables_and_enables_between_sets(tmp_path: Path) -> None:
    orders: list[Order] = [
        (0.9, "disable", {"position": "C", "note": "sensor taken off"}),
        (0.9, "disable", {"position": "C"}),
        (0.9, "disable", {"position": "A"}),
        (1.9, "enable", {"position": "C"}),
        (1.9, "enable", {"position": "C"}),
    ]
    settings = small_settings(schedule={"end_h": 3.0})
    assert run(settings, tmp_path, rig=ordering_rig(tmp_path, orders))
    rows = sets_of(tmp_path, "C")
    assert [row.state for row in rows] == ["done"] + ["retired"] * 2 + ["done"] * 3
    assert {row.cause for row in rows[1:3]} == {"retired by ann: sensor taken off"}
    assert [(state, result) for _, state, result in answers(tmp_path)] == [
        ("done", "C is disabled"),
        ("refused", "C is disabled already"),
        ("refused", "there is no solitary-wave transducer 'A'; there are: B, C, D"),
        ("done", "C strikes again from the next set"),
        ("refused", "C is not disabled"),
    ]
    assert {row.state for name in "ABD" for row in sets_of(tmp_path, name)} == {"done"}


IN_SET_1 = 1.0 + 16 / 3600  # between C's first strike (12 s after the hour) and its second


def test_a_transducer_disabled_during_its_set_is_not_struck_again(tmp_path: Path) -> None:
    orders: list[Order] = [(IN_SET_1, "disable", {"position": "C", "note": "coil is hot"})]
    assert run(two_hours(), tmp_path, rig=ordering_rig(tmp_path, orders))
    rows = sets_of(tmp_path, "C")
    assert [(row.state, row.n_taken) for row in rows] == [
        ("done", 3),
        ("partial", 1),
        ("retired", 0),
        ("retired", 0),
    ]
    assert rows[1].cause == "retired by ann: coil is hot"
    assert {row.state for row in sets_of(tmp_path, "D")} == {"done"}
    # The slot in which the order came is lost, those of the shots that are not taken are not waited for.
    assert shots_of(tmp_path, "D", 1)[0].utc_ns - rows[1].due_utc_ns == 5 * STEP_NS


def test_a_transducer_disabled_after_its_shots_keeps_them(tmp_path: Path) -> None:
    orders: list[Order] = [(IN_SET_1, "disable", {"position": "B"})]
    assert run(only("BC", two_hours()), tmp_path, rig=ordering_rig(tmp_path, orders))
    assert [row.state for row in sets_of(tmp_path, "B")] == ["done", "done", "retired", "retired"]
    assert [row.state for row in sets_of(tmp_path, "C")] == ["done"] * 4


def test_a_transducer_enabled_during_a_set_starts_with_the_next_one(tmp_path: Path) -> None:
    orders: list[Order] = [(0.4, "disable", {"position": "B"}), (IN_SET_1, "enable", {"position": "B"})]
    assert run(only("BC", two_hours()), tmp_path, rig=ordering_rig(tmp_path, orders))
    assert [row.state for row in sets_of(tmp_path, "B")] == ["retired", "retired", "done", "done"]
    assert "B" not in {place.position for place in read_set(set_files(tmp_path)[1]).positions}


# Hold ------------------------------------------------------------------------------------------


def struck(folder: Path) -> list[ShotKey]:
    return [shot.key for path in set_files(folder).values() for shot in read_set(path).shots]


@pytest.mark.slow
def test_a_pause_during_a_set_stops_the_strikes(tmp_path: Path) -> None:
    orders: list[Order] = [(IN_SET_1, "pause", {"note": "door open"}), (1.9, "resume", {})]
    settings = small_settings(schedule={"end_h": 2.5})
    assert run(settings, tmp_path, rig=ordering_rig(tmp_path, orders))
    states = {name: [row.state for row in sets_of(tmp_path, name)] for name in "ABCD"}
    assert states == {
        "A": ["done", "done", "missed", "done", "done"],
        "B": ["done", "done", "missed", "done", "done"],
        "C": ["done", "partial", "missed", "done", "done"],
        "D": ["done", "missed", "missed", "done", "done"],
    }
    held = "held by ann: door open"
    assert [(row.n_taken, row.cause) for row in sets_of(tmp_path, "C")[1:3]] == [(1, held), (0, held)]
    assert sets_of(tmp_path, "D")[1].cause == held
    assert [key.position for key in struck(tmp_path) if key.set_index == 1] == ["B", "B", "B", "C"]
    assert [state for _, state, _ in answers(tmp_path)] == ["done", "done"]


def test_a_pause_survives_a_restart_and_ends_by_resuming(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = only("B", small_settings(schedule={"end_h": 3.0}))
    stop_at_2: list[Order] = [
        (0.9, "pause", {"note": "hands in the rig"}),
        (0.9, "pause", {"note": "again"}),
        (1.9, "stop", {}),
    ]
    assert not run(settings, tmp_path, rig=ordering_rig(tmp_path, stop_at_2))
    assert [row.state for row in sets_of(tmp_path, "B")] == ["done", "missed", "missed"]
    assert describe_status(tmp_path, Settings())["held"] == "held by ann: hands in the rig"
    run_status(config=None, data_dir=tmp_path, as_json=False, watch=False)
    assert "paused    held by ann: hands in the rig" in capsys.readouterr().out
    orders: list[Order] = [(2.4, "resume", {"note": "closed"}), (2.4, "resume", {})]
    assert run(settings, tmp_path, rig=ordering_rig(tmp_path, orders))
    rows = sets_of(tmp_path, "B")
    assert [row.state for row in rows] == ["done", "missed", "missed", "missed", "done", "done"]
    assert {row.cause for row in rows[1:4]} == {"held by ann: hands in the rig"}
    assert [(state, result.partition(":")[0]) for kind, state, result in answers(tmp_path)] == [
        ("done", "paused"),
        ("refused", "the test is already paused"),
        ("done", "stopping after the shot being taken"),
        ("done", "resumed"),
        ("refused", "the test is not paused"),
    ]
    assert describe_status(tmp_path, Settings())["held"] is None


def test_sets_cut_short_by_pauses_are_not_counted_against_a_transducer(tmp_path: Path) -> None:
    """B has one shot in each of four sets: too few, but it was not struck."""
    orders: list[Order] = []
    for hour in (0.5, 1.0, 1.5, 2.0):
        orders += [(hour + 4 / 3600, "pause", {"note": "why"}), (hour + 0.4, "resume", {})]
    settings = only("B", small_settings(schedule={"end_h": 2.5}, quality=SILENT))
    assert run(settings, tmp_path, rig=ordering_rig(tmp_path, orders))
    assert [row.n_taken for row in sets_of(tmp_path, "B")] == [1, 1, 1, 1, 3]
    assert alarms_of(tmp_path) == {}


# A rig that is gone or busy --------------------------------------------------------------------


def lost_during(sets: range, position: str, times: int, error: type[Exception]) -> tuple[Disturb, list]:
    """Let the first ``times`` strikes of a position in each set meet a lost connection."""

    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        tried.append(key)
        if key.set_index in sets and key.position == position and key.shot_index < times:
            raise error(f"board 01A2B3C4 is gone at {key.position}{key.shot_index}")
        return acquired

    tried: list[ShotKey] = []
    return disturb, tried


FOUR_SHOTS = {"end_h": 2.5, "shots_per_set": 4}


def test_three_consecutive_lost_connections_end_a_set_and_the_next_is_taken(tmp_path: Path) -> None:
    disturb, tried = lost_during(range(1, 3), "C", 3, ConnectionLostError)
    assert run(small_settings(schedule=FOUR_SHOTS), tmp_path, rig=disturbed_rig(disturb))
    keys = [(key.position, key.shot_index, key.attempt) for key in tried if key.set_index == 1]
    assert keys[4:] == [("C", 0, 0), ("C", 1, 0), ("C", 2, 0)], "a lost connection is no strike to repeat"
    rows = sets_of(tmp_path, "C")
    assert [row.state for row in rows] == ["done", "missed", "missed", "done", "done"]
    assert (rows[1].n_missed, rows[1].n_restrikes) == (3, 0)
    assert rows[1].cause == "board 01A2B3C4 is gone at C2; 3 missed: board 01A2B3C4 is gone at C0"
    assert sets_of(tmp_path, "D")[1].cause == "board 01A2B3C4 is gone at C2"
    assert sets_of(tmp_path, "B")[1].state == "done"
    reasons = {item.reason for item in read_set(set_files(tmp_path)[1]).missed}
    assert reasons == {"connection_lost"}
    alarm = alarms_of(tmp_path)[None, "rig_unavailable"]
    assert (alarm.raised_set_index, alarm.state) == (1, "returned_unacknowledged")
    assert alarm.proof == {"set_index": 1, "error": "ConnectionLostError"}
    assert alarm.message == ("set 1 ended early: board 01A2B3C4 is gone at C2; the next set tries again")
    with open_catalogue(tmp_path) as catalogue:
        alarm_events = [
            (event.kind, event.set_index)
            for event in catalogue.events_after(0, {"alarms"}, limit=None)
            if event.payload["kind"] == "rig_unavailable"
        ]
    assert alarm_events == [("alarm_raised", 1), ("alarm_cleared", 3)]


def test_two_lost_connections_cost_two_shots(tmp_path: Path) -> None:
    disturb, _ = lost_during(range(1, 2), "C", 2, ConnectionLostError)
    assert run(small_settings(schedule=FOUR_SHOTS), tmp_path, rig=disturbed_rig(disturb))
    row = sets_of(tmp_path, "C")[1]
    assert (row.state, row.n_taken, row.n_missed) == ("partial", 2, 2)
    assert sets_of(tmp_path, "D")[1].state == "done"
    assert alarms_of(tmp_path) == {}


def test_a_long_loss_of_the_rig_disables_no_transducer(tmp_path: Path) -> None:
    disturb, _ = lost_during(range(1, 5), "B", 4, ConnectionLostError)
    settings = only("AB", small_settings(schedule={**FOUR_SHOTS, "end_h": 3.0}, quality=SILENT))
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    assert [row.state for row in sets_of(tmp_path, "B")] == ["done"] + ["missed"] * 4 + ["done"]
    assert set(alarms_of(tmp_path)) == {(None, "rig_unavailable")}


def test_a_busy_rig_ends_the_set_at_once_and_the_next_one_is_taken(tmp_path: Path) -> None:
    disturb, tried = lost_during(range(1, 2), "B", 1, BusyError)
    assert run(small_settings(schedule=FOUR_SHOTS), tmp_path, rig=disturbed_rig(disturb))
    assert len([key for key in tried if key.set_index == 1]) == 1
    assert [row.state for row in sets_of(tmp_path, "A")] == ["done"] * 5, "its echo was there before"
    for position in "BCD":
        rows = sets_of(tmp_path, position)
        assert [row.state for row in rows] == ["done", "missed", "done", "done", "done"]
        assert rows[1].cause == "board 01A2B3C4 is gone at B0"
    alarm = alarms_of(tmp_path)[None, "rig_unavailable"]
    assert (alarm.state, alarm.proof["error"]) == ("returned_unacknowledged", "BusyError")


def test_a_set_without_any_record_raises_the_alarm_too(tmp_path: Path) -> None:
    """No pulse-echo position, so nothing at all is stored of the set."""

    def disturb(key: ShotKey, acquired: Acquired) -> Acquired:
        if key.set_index == 1:
            raise ConnectionLostError("board 01A2B3C4 is gone")
        return acquired

    settings = only("B", small_settings(schedule=FOUR_SHOTS))
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    assert sorted(set_files(tmp_path)) == [0, 2, 3, 4]
    row = sets_of(tmp_path, "B")[1]
    assert (row.state, row.file, row.n_missed, row.n_restrikes) == ("missed", None, 3, 0)
    assert alarms_of(tmp_path)[None, "rig_unavailable"].raised_set_index == 1


TWO_SHOTS = {"end_h": 2.5, "shots_per_set": 2}


def test_a_rig_that_answers_nothing_in_short_sets_raises_the_alarm(tmp_path: Path) -> None:
    """Too few strikes to give the set up, but not one was answered."""
    disturb, _ = lost_during(range(1, 3), "B", 2, ConnectionLostError)
    settings = only("AB", small_settings(schedule=TWO_SHOTS))
    assert run(settings, tmp_path, rig=disturbed_rig(disturb))
    alarm = alarms_of(tmp_path)[None, "rig_unavailable"]
    assert (alarm.raised_set_index, alarm.state) == (1, "returned_unacknowledged")
    assert alarm.message == "set 1 got no answer: board 01A2B3C4 is gone at B1; the next set tries again"


def test_one_strike_that_is_answered_is_no_trouble_of_the_rig(tmp_path: Path) -> None:
    disturb, _ = lost_during(range(1, 3), "B", 2, ConnectionLostError)
    assert run(small_settings(schedule=TWO_SHOTS), tmp_path, rig=disturbed_rig(disturb))
    assert (None, "rig_unavailable") not in alarms_of(tmp_path)


def test_a_rig_that_cannot_meet_a_request_reports_that_the_recorder_stopped(tmp_path: Path) -> None:
    disturb, _ = lost_during(range(1), "C", 1, ConfigurationError)
    with pytest.raises(RigError, match="set 0 ended early"):
        run(small_settings(schedule=FOUR_SHOTS), tmp_path, rig=disturbed_rig(disturb))
    alarm = alarms_of(tmp_path)[None, "rig_unavailable"]
    assert (alarm.state, alarm.proof["error"]) == ("unacknowledged", "ConfigurationError")
    assert alarm.message.endswith(
        "; the recorder has stopped: mend the cause and start it again; it goes on with the schedule"
    )


@pytest.mark.parametrize("late", [False, True])
def test_a_pause_does_not_report_that_the_rig_is_back(tmp_path: Path, late: bool) -> None:
    """Heard while the set is awaited, or when its first record is."""
    disturb, _ = lost_during(range(1, 2), "B", 4, ConnectionLostError)
    rig = ordering_rig(tmp_path, [(1.5, "pause", {"note": "why"})], disturb, late=late)
    assert run(only("AB", small_settings(schedule=FOUR_SHOTS)), tmp_path, rig=rig)
    assert [row.state for row in sets_of(tmp_path, "B")] == ["done"] + ["missed"] * 4
    assert alarms_of(tmp_path)[None, "rig_unavailable"].state == "unacknowledged"


def test_a_poor_shot_at_the_end_of_a_cut_set_is_counted_as_it_was_struck(tmp_path: Path) -> None:
    """The gate grants a repetition, and a hold comes before it: it was never made."""
    orders: list[Order] = [(1.0 + 4 / 3600, "pause", {"note": "door open"})]
    settings = only("B", two_hours())
    assert run(settings, tmp_path, rig=ordering_rig(tmp_path, orders, silent("B", from_set=1)))
    row = sets_of(tmp_path, "B")[1]
    assert (row.state, row.n_missed, row.n_restrikes) == ("missed", 1, 0)
    assert row.cause == f"held by ann: door open; 1 missed: {NO_TRIGGER}"
