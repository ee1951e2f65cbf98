"""The corrosion drive of a running test, on a pseudo terminal: logged with every set, switched by order."""

import threading

import pytest
from support.small_experiment import small_settings
from support.stepped_clock import SteppedClock
from support.stored_files import read_set, set_files

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import AlarmRow, EnvironmentRow
from daq_service.processes.data_folder import own_data_folder, prepare_data_folder
from daq_service.recording.resources import Host
from daq_service.recording.session import record
from daq_service.rig.open_rig import open_rig
from simulator.doubles.serial.instruments import SerialInstruments
from simulator.doubles.serial.link import pseudo_terminals_missing
from simulator.doubles.serial.supply import Supply

NO_TERMINALS = pseudo_terminals_missing()
pytestmark = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS or "available")

SECOND_H = 1.0 / 3600.0


@pytest.fixture
def instruments(tmp_path):
    (tmp_path / "ports").mkdir()
    with SerialInstruments(tmp_path / "ports", supply=Supply(noise_v=0.0, noise_a=0.0)) as instruments:
        yield instruments


def settings_with(instruments, sets, *, off_at_end=True, **tables):
    """Return settings of a set per second on the twin, with the driver of the real supply."""
    line = {"reply_timeout_s": 60.0}  # the doubles answer at once, on a busy machine later
    return small_settings(
        clock={"kind": "wall"},
        schedule={
            "phases": [{"until_h": sets * SECOND_H, "interval_h": SECOND_H}],
            "shots_per_set": 2,
            "shot_interval_s": 0.05,
        },
        baseline={"hours": 100.0},
        rig={
            "supply": {
                "line": {"port": str(instruments.supply_link.path), **line},
                "identity": "SOLIMON,DC SUPPLY DOUBLE",
                "log_interval_s": 0.2,
                "off_at_end": off_at_end,
                "interlock_lost_after_s": 1.5,
            },
            "climate": {
                "line": {"port": str(instruments.climate_link.path), **line},
                "identity": "SOLIMON,CLIMATE PROBE DOUBLE",
                "log_interval_s": 0.5,
            },
        },
        **tables,
    )


def run(settings, folder, orders=None, act=None, stop_after=None, clock=None):
    """Record to the end; after the n-th set give a command or disturb the instruments."""
    prepare_data_folder(folder)

    def notify(event, **values):
        if event != "progress":
            return
        if (orders or {}).get(values["done"]):
            kind, arguments = (orders or {})[values["done"]]
            with open_catalogue(folder, writer=True) as catalogue:
                catalogue.add_command("Ada", kind, dict(arguments))
        action = (act or {}).get(values["done"])
        if action is not None:
            action()
        if values["done"] == stop_after:
            stop.set()

    stop = threading.Event()
    with own_data_folder(folder):
        return record(
            settings,
            folder,
            open_rig,
            stop=stop,
            report=notify,
            host=Host(listen_every_s=0.0, wall_clock=(clock or SteppedClock()).start),
        )


def environment(folder):
    with open_catalogue(folder) as catalogue:
        return catalogue.rows(EnvironmentRow)


def alarms(folder):
    with open_catalogue(folder) as catalogue:
        return {row.kind: row for row in catalogue.rows(AlarmRow)}


def switchings(instruments):
    return [(change.on, change.cause) for change in instruments.output_changes()]


def test_a_person_switches_it_on_each_set_logs_it_and_the_end_switches_it_off(instruments, tmp_path):
    folder = tmp_path / "data"
    assert run(settings_with(instruments, 6), folder, orders={1: ("supply_on", {})})
    assert switchings(instruments) == [(True, "command"), (False, "command")]
    rows = environment(folder)
    assert len(rows) == 6
    assert rows[0].supply_state == "off"
    last = rows[-1]
    assert (last.supply_state, last.supply_quality) == ("on", "good")
    assert last.voltage_v == pytest.approx(10.0, abs=1e-9)  # no noise, read back as set
    # Trapezoid of a nearly constant current over the four seconds and more after the order.
    assert 3.0 * last.current_a < last.charge_coulomb < 6.0 * last.current_a
    assert last.supply_age_s < 1.0
    assert last.climate_quality == "good"
    assert 0.0 < last.relative_humidity < 1.0
    stored = read_set(set_files(folder)[5])
    assert stored.environment["supply_state"] == "on"
    assert stored.environment["charge_coulomb"] == pytest.approx(last.charge_coulomb, rel=0.2)
    assert alarms(folder).keys() <= {"not_assessed"}, "its baseline has two sets"


def test_a_restart_goes_on_counting_and_switches_nothing(instruments, tmp_path):
    folder, clock = tmp_path / "data", SteppedClock()
    settings = settings_with(instruments, 8, off_at_end=False)
    assert not run(settings, folder, orders={1: ("supply_on", {})}, stop_after=3, clock=clock)
    before = environment(folder)[-1]
    assert instruments.supply.on, "it was told to leave it as it is"
    assert run(settings, folder, clock=clock)
    assert switchings(instruments) == [(True, "command")]
    after = environment(folder)[-1]
    assert after.supply_state == "on"
    assert after.charge_coulomb > before.charge_coulomb > 0.0
    # Nothing was measured between the two runs.
    assert after.unknown_s > before.unknown_s


def test_a_hole_trips_the_interlock_and_only_a_person_resets_it(instruments, tmp_path):
    folder = tmp_path / "data"
    thinning = {"B": {"onset_h": 0.0, "reference_h": 3.0, "depth_fraction": 0.5, "hole_h": 2.5 * SECOND_H}}
    settings = settings_with(
        instruments, 7, twin={"thinning": thinning, "update_interval_s": 1.0}, alarms={"hole_shots": 2}
    )
    assert run(settings, folder, orders={1: ("supply_on", {}), 6: ("supply_on", {"voltage_v": 5.0})})
    assert switchings(instruments) == [
        (True, "command"),
        (False, "command"),  # the hole
        (True, "command"),  # Ada
        (False, "command"),  # the end
    ]
    found = alarms(folder)
    assert found["no_reflection"].position == "B"
    assert found["interlock_tripped"].raised_h == found["no_reflection"].raised_h
    assert found["interlock_tripped"].priority == "critical"
    assert "hole" in found["interlock_tripped"].message
    assert found["interlock_tripped"].state == "returned_unacknowledged", "closed by the order, not yet seen"
    tripped = [row.supply_tripped for row in environment(folder)]
    assert tripped[0] is None
    assert "no reflected wave" in tripped[4]
