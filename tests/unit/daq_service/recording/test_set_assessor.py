"""A set becomes rows and alarms in one transaction; the state after a restart."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from support.memory_archive import MemoryArchive, bits
from support.memory_line import SETS, Line, healthy, memory_settings, silent
from support.synthetic_records import Scene, waveform_of
from support.table_rows import forget_states

from analysis.statistics.named_limits import LIMITS
from daq_service.acquisition.schedule import plan_sets
from daq_service.archive.errors import ArchiveReadError
from daq_service.clock import parse_utc
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.instruments import Echo, Rig
from hardware_drivers.measurement import ShotKey, Waveform
from simulator.echo.pulse import build_echo_calibration, simulate_echo
from simulator.electronics.transduction import quantise_volts
from simulator.parameters.echo import EchoParameters


@pytest.fixture
def line(tmp_path):
    return Line(tmp_path / "data")


class Drive:
    """Corrosion supply double that records its trips and the requested rows."""

    def __init__(self):
        self.trips, self.rows = [], 0

    def trip(self, reason, hour):
        self.trips.append((reason, hour))

    def add_environment_row(self, transaction, due, moment):
        self.rows += 1


@contextmanager
def assessor_of(line):
    """Return a set assessor that continues after the line's last recorder."""
    with line.catalogue(writer=True) as catalogue:
        line.epoch_ns(catalogue)
        rig = Rig(kind="simulated", clock=None, striker=None, digitizer=None)
        yield SetAssessor(line.settings, MemoryArchive(line.shelf), catalogue, rig)


@contextmanager
def recorded(line, count):
    """Return a folder with assessed sets, the records of all sets, and a set assessor that continues."""
    line.run()
    records = {record.set_index: (record, file) for file, record in line.shelf.sets.items()}
    again = Line(line.folder.parent / "again", line.settings, line.script, line.shelf)
    with assessor_of(again) as ledger:
        for index in range(count):
            assess_set(ledger, again, *records[index])
    with assessor_of(again) as ledger:
        yield ledger, again, records


def due_of(line, index):
    return plan_sets(line.settings.schedule.phases, parse_utc(line.settings.clock.epoch))[index]


def assess_set(ledger, line, record, file):
    features = {shot.sequence: line.features_of(shot) for shot in record.shots}
    due = record.due if record.unscheduled_index else due_of(line, record.set_index)
    ledger.commit(ledger.assessed(due, record, file, features))


def test_a_restart_after_any_set_does_not_change_the_assessments(line):
    line.settings = memory_settings(
        schedule={"phases": [{"until_h": 11.0, "interval_h": 0.5}]},
        baseline={"hours": 8.0, "minimum_sets": 15},
        alarms={"decides_by": "chart", "false_alarms_per_sensor_year": 50.0},
    )
    wall = {"B": 0.008, "C": 0.0, "D": 0.1}
    line.script = lambda key: healthy(key, shift=wall.get(key.position, 0.0) * max(0, key.set_index - 15))
    line.run()
    expected = {name: line.rows(name) for name in ("assessments", "alarms", "features", "baselines")}
    raised = [row for row in expected["alarms"] if row.kind == "wall_change"]
    assert [row.position for row in raised] == ["D", "B"]
    assert raised[0].evidence["mewma_statistic"] > raised[0].evidence["limit"]
    assert raised[0].evidence["rate_verified"] is False
    assert raised[0].evidence["rate_not_verified_reason"].startswith("16 sets, 150 needed")
    assert [row.limits.keys() for row in expected["baselines"]] == [LIMITS.keys()] * 3
    assert {row.baseline_quality["rate_not_verified_reason"][:7] for row in expected["baselines"]} == {
        "16 sets"
    }
    assert [(row.state, row.approved_utc_ns is None) for row in expected["baselines"]] == [
        ("approved", False)
    ] * 3
    again = Line(line.folder.parent / "again", line.settings, line.script)
    for record in sorted(line.shelf.sets.values(), key=lambda record: record.set_key):
        with assessor_of(again) as ledger:  # a new one for every set
            assess_set(ledger, again, record, f"sets/{record.set_index}")
    assert {name: again.rows(name) for name in expected} == expected
    assert restored_states(again) == restored_states(line)
    assert_rows_have_the_stored_states(again)


def renewing_script(line):
    """Return a script in which a person renews the baseline of B while set 17 is struck."""
    asked = []

    def script(key):
        if key == ShotKey(position="B", set_index=17, shot_index=0) and not asked:
            asked.append(key)
            line.order("renew_baseline", position="B", note="coupled anew")
        return healthy(key, shift=0.2 if key.position == "B" and key.set_index > 15 else 0.0)

    return script


def test_a_new_baseline_starts_with_the_next_scheduled_set(line):
    line.settings = memory_settings(
        schedule={"phases": [{"until_h": 18.0, "interval_h": 0.5}], "shots_per_set": 1},
        baseline={"hours": 7.5, "minimum_sets": 15, "minimum_valid_shots": 1, "approval": "by_a_person"},
    )
    line.listen_every_s, line.script = 0.0, renewing_script(line)
    line.run()
    first, second = line.rows("baselines", "B")
    assert (first.id, first.name, first.state, first.last_set_index) == (2, "B-baseline-1", "retired", 14)
    assert (second.id, second.name, second.state, second.n_sets) == (6, "B-baseline-2", "proposed", 15)
    assert (second.first_set_index, second.last_set_index) == (18, 32)
    tofs = [row.tof_pp_s for row in line.rows("features", "B") if row.shot_index is None]
    assert second.mean[0] == pytest.approx(np.mean(tofs[18:33]), rel=1e-12)  # the same doubles, summed alike
    assert (second.baseline_quality["n"], second.baseline_quality["advice"][:19]) == (
        15,
        "fewer than 48 sets:",
    )
    assessments = line.rows("assessments", "B")
    assert [row.set_index for row in assessments if row.in_baseline] == [*range(15), *range(18, 33)]
    assert [row.outlier for row in assessments[15:18]] == [False, True, None], "16 by the baseline of before"
    assert assessments[17].reason == "its baseline was retired before it was assessed"
    assert {(row.baseline_id, row.outlier) for row in assessments[33:]} == {(6, False)}
    assert [(row.state, row.approved_utc_ns) for row in line.rows("baselines", "C")] == [("proposed", None)]
    stopped = Line(line.folder.parent / "stopped", line.settings, listen_every_s=0.0)
    script = renewing_script(stopped)
    for set_index in (17, 20, 32, 34):  # before, during and after the collection of the new baseline
        run_until(stopped, "D", set_index, script)
    stopped.script = script
    stopped.run()
    for name in ("assessments", "features", "baselines"):
        assert stopped.rows(name) == line.rows(name)
    assert restored_states(stopped) == restored_states(line)
    assert_rows_have_the_stored_states(line)


def restored_states(line):
    """Return the state of each position after a restart, every bit of it."""
    with assessor_of(line) as ledger:
        return {name: bits(state) for name, state in ledger.assessors.states.items()}


def assert_rows_have_the_stored_states(line):
    """Check that the rows of all sets give the states that are stored."""
    expected = restored_states(line)
    forget_states(line.folder)
    assert restored_states(line) == expected


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 8))])
def test_the_stored_state_is_that_of_all_stored_sets(line, seed):
    line.settings = memory_settings(
        schedule={"phases": [{"until_h": 45.0, "interval_h": 1.0}], "shots_per_set": 3},
        baseline={"hours": 16.0, "minimum_sets": 15, "minimum_valid_shots": 2},
        quality={"retire_after_sets": 0, "restrikes_per_set": 0},
        alarms={"k": 2, "n": 3, "hole_shots": 3, "hole_sets": 30},
    )

    def script(key):
        lot = np.random.default_rng([seed, ord(key.position), key.set_index // 3]).random()
        if key.position == "A" or lot < 0.4 or key.set_index < 16:
            return healthy(key)
        return healthy(key, shift=0.5) if lot < 0.7 else silent("noisy") if lot < 0.85 else None

    line.script = script
    line.run()
    assert_rows_have_the_stored_states(line)
    assert len({str(state[3:]) for state in restored_states(line).values()}) > 1, "there is something to know"


def test_a_restart_reads_the_stored_states_and_no_sets(line, monkeypatch):
    line.run(pulse_echo=ThinningWall())

    def refused(*_):
        raise AssertionError("a state is computed again")

    monkeypatch.setattr("daq_service.assessment.restore_state.replay_stored_sets", refused)
    restored_states(line)
    # The settings that a state was computed with are part of it, and so is its format.
    other = memory_settings(alarms={"k": 1})
    with line.catalogue(writer=True) as catalogue, pytest.raises(AssertionError, match="computed again"):
        SetAssessor(other, MemoryArchive(line.shelf), catalogue, None)
    monkeypatch.setattr("daq_service.assessment.restore_state.STATE_FORMAT", 0)
    with pytest.raises(AssertionError, match="computed again"):
        restored_states(line)


def test_a_restart_from_stored_rows_restores_an_old_active_alarm(line):
    line.settings = memory_settings(
        schedule={"phases": [{"until_h": 40.0, "interval_h": 1.0}], "shots_per_set": 1},
        baseline={"hours": 16.0, "minimum_sets": 15, "minimum_valid_shots": 1},
        alarms={"k": 2, "n": 3},
    )
    # Two consecutive outliers raise it; one in three neither clears nor raises it.
    line.script = lambda key: healthy(key, shift=0.5 * (key.set_index in (17, 18, *range(20, 40, 3))))
    line.run()
    forget_states(line.folder)
    with assessor_of(line) as ledger:
        assert [ledger.assessors[name].state.alarm.active for name in "BCD"] == [True] * 3


def test_a_hole_trips_the_supply_immediately_and_once(line):
    line.script = lambda key: silent() if key.position == "C" and key.set_index >= 3 else healthy(key)
    with recorded(line, 3) as (ledger, again, records):
        ledger.drive = drive = Drive()
        assess_set(ledger, again, *records[3])
        assert drive.trips == []
        assess_set(ledger, again, *records[4])
        ((reason, hour),) = drive.trips
        assert reason == "C: no reflected wave, possible hole or lost contact"
        assert hour == 2.5
        assert ledger.disabled().keys() == {"C"}
        assert drive.rows == 2


def test_sets_of_lost_samples_are_no_data_and_no_hole(line):
    """A transfer that ends after the incident wave has no reflected wave either."""
    random = np.random.default_rng(0)
    volts = Scene(isw_v=1.0).volts() + 0.01 * random.standard_normal(13_000)
    volts[3_000:] = 0.0
    lost = waveform_of(volts)
    line.script = lambda key: lost if key.position == "C" and key.set_index in (3, 4) else healthy(key)
    with recorded(line, 3) as (ledger, again, records):
        ledger.drive = drive = Drive()
        for index in (3, 4):
            assess_set(ledger, again, *records[index])
        assert (drive.trips, ledger.disabled()) == ([], {})
    assert {row.kind for row in line.alarms()} == {"few_valid_shots"}


def test_a_residue_below_a_quarter_of_the_baseline_s_ratio_is_a_hole(line):
    """Each shot is valid, and all shots of the set agree."""
    residue = {"amplitude_ratio": 0.11, "isw_amplitude_v": 2.0, "isw_fwhm_s": 65e-6}

    def script(key):
        odd = key.position == "C" and key.set_index > 16
        return replace(healthy(key), **residue) if odd else healthy(key)

    line.script = script
    line.settings = memory_settings(
        schedule={"phases": [{"until_h": 9.5, "interval_h": 0.5}]}, baseline={"hours": 8.0}
    )
    line.run()
    assert {(row.position, row.kind) for row in line.alarms()} == {("C", "no_reflection")}


def run_until(line, position, set_index, script, **parts):
    """Run until the last strike of a transducer in a set."""
    line.script, last = script, line.settings.schedule.shots_per_set - 1
    assert not line.run(
        stop=line.stop_at(ShotKey(position=position, set_index=set_index, shot_index=last)), **parts
    )


def test_a_restart_restores_an_enabled_transducer(line):
    def script(key):
        return silent("noisy") if key.position == "D" and key.set_index in (0, 1, 2, 4, 5) else healthy(key)

    run_until(line, "C", 3, script)  # D disabled after three poor sets: C's is the last strike
    line.order("enable", position="D")
    run_until(line, "D", 4, script)
    assert_rows_have_the_stored_states(line)
    line.script = script
    line.run()
    assert [row.state for row in line.rows("sets", "D")] == ["done"] * 3 + ["disabled"] + ["done"] * 8


def test_after_a_restart_a_repeated_shot_does_not_count_for_a_hole(line):
    def script(key):
        if key.position != "B" or key.set_index not in (1, 2):
            return healthy(key)
        # In set 1 two of the three silent shots were struck again, and their repetitions count.
        silences = key.attempt == 0 and key.shot_index < 3 if key.set_index == 1 else key.shot_index < 3
        return silent() if silences else healthy(key)

    run_until(line, "D", 1, script)
    assert [shot.outcome for shot in line.rows("shots", "B")].count("superseded") == 2
    assert_rows_have_the_stored_states(line)
    line.script = script
    line.run()
    assert "B" not in {row.position for row in line.rows("alarms") if row.kind == "no_reflection"}


class ThinningWall:
    """Pulse-echo unit on a wall with a constant loss per set and no scatter."""

    echo = EchoParameters(
        element_separation_m=0.0, roughness_fraction=0.0, velocity_per_k=0.0, bubble_probability=0.0
    )

    def acquire(self, key, timeout_s):
        calibration = build_echo_calibration(self.echo)
        volts = simulate_echo(6.35e-3 - 0.2e-3 * key.set_index, self.echo)
        waveform = Waveform(
            counts=quantise_volts(volts, calibration),
            sample_rate_hz=1e8,
            pretrigger_samples=0,
            calibration=calibration,
        )
        return Echo(waveform=waveform, gain_db=30.0, offset_v=0.0, averages=16)


def test_a_restart_measures_the_wall_from_the_first_echo_of_the_test(line):
    run_until(line, "D", 5, healthy, pulse_echo=ThinningWall())
    line.script = healthy
    assert_rows_have_the_stored_states(line)
    line.run(pulse_echo=ThinningWall())
    lost_m = [row.thickness_loss_m for row in line.rows("thickness")]
    # 1e-6 m: a hundredth of a sample of the echo's carrier, twenty times below the loss of a set.
    assert lost_m == pytest.approx([0.2e-3 * index for index in range(SETS)], abs=1e-6)


def test_a_later_echo_is_the_reference_if_the_first_record_is_lost(line, caplog):
    run_until(line, "D", 5, healthy, pulse_echo=ThinningWall())
    line.script = healthy
    for index in (0, 1):
        (file,) = (file for file, record in line.shelf.sets.items() if record.set_index == index)
        del line.shelf.sets[file]
    forget_states(line.folder)
    line.run(pulse_echo=ThinningWall())
    lost_m = [row.thickness_loss_m for row in line.rows("thickness")]
    # As without the loss: the times of the third set are those that the lost record gave it.
    assert lost_m == pytest.approx([0.2e-3 * index for index in range(SETS)], abs=1e-6)
    assert "set 2 replaces the reference of A" in caplog.text


def test_a_temporary_read_error_does_not_change_the_reference_echo(line, monkeypatch):
    line.run(pulse_echo=ThinningWall())
    forget_states(line.folder)

    def refused(archive, *_):
        raise ArchiveReadError("too many open files")

    monkeypatch.setattr(MemoryArchive, "read_waveform", refused)
    with pytest.raises(ArchiveReadError, match="too many open files"):
        line.run(pulse_echo=ThinningWall())


def test_the_rig_alarm_names_a_method_whose_instruments_do_not_respond(line):
    lost = ConnectionLostError("the probe's board is gone")
    line.script = lambda key: lost if key.position == "A" and key.set_index == 2 else healthy(key)
    line.run()
    (alarm,) = [row for row in line.rows("alarms") if row.kind == "instruments_unavailable"]
    assert alarm.raised_set_index == 2
    assert alarm.evidence["error_message"] == "the probe's board is gone"
    assert alarm.state == "returned_unacknowledged"


def test_gaps_and_alarms_are_reported_after_they_are_stored(line):
    def hole_at_c_and_nothing_once_at_d(key):
        if (key.set_index, key.position) == (3, "D"):
            return None  # no trigger
        return silent() if key.position == "C" and key.set_index >= 5 else healthy(key)

    line.script = hole_at_c_and_nothing_once_at_d
    reports = []

    def report(event, **values):
        if event in ("alarm", "gap") and "wall not monitored" not in values.get("message", ""):
            reports.append((event, values, len(line.alarms()), len(line.rows("sets", "D"))))

    line.run(notify=report)
    gap, alarm = reports
    assert gap[0] == "gap"
    assert (gap[1]["set_index"], gap[1]["state"], gap[1]["positions"]) == (3, "missed", ["D"])
    assert gap[1]["reason"] == line.rows("sets", "D")[3].reason
    assert gap[3] == 4, "its row is stored before it is told"
    row = line.alarms()[-1]
    assert alarm[0] == "alarm"
    assert alarm[1] == {
        "change": "alarm_raised",
        "hour": row.raised_h,
        "priority": row.priority,
        "message": row.message,
    }
    assert alarm[2] == len(line.alarms())
