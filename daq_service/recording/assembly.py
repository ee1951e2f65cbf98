"""Make the parts of a recorder, and connect them."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from daq_service.acquisition.schedule import DueSet, plan
from daq_service.acquisition.taken_set import features_of
from daq_service.catalogue.rows import AnnotationRow
from daq_service.commands.execution import CommandExecutor
from daq_service.commands.running_test import RunningTest
from daq_service.recording.acquire_set import FeaturesOf, SetAcquisition
from daq_service.recording.carried_over import CarriedOver, refuse_foreign_open_sets
from daq_service.recording.clock_watch import ClockWatch
from daq_service.recording.computer_load import ComputerLoadWatch
from daq_service.recording.cost import Cost
from daq_service.recording.host import THIS_COMPUTER, Host
from daq_service.recording.persistence import Helpers, Persistence, Stores
from daq_service.recording.presence import Presence, Reporter
from daq_service.recording.resumed_time import moment_at
from daq_service.recording.self_calibration import SelfCalibration
from daq_service.recording.set_assessor import SetAssessor
from daq_service.recording.unscheduled_sets import UnscheduledSets
from daq_service.recording.waiting import Waiting
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig
from hardware_drivers.methods import SOLITARY_WAVE

NO_HELPERS = Helpers()


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What a recorder is made of.

    Attributes
    ----------
    plan
        Every scheduled set; the set of index k is the k-th.
    computer_load
        Reads with each set what the test costs its computer.
    """

    plan: Sequence[DueSet]
    stores: Stores
    rig: Rig
    in_real_time: bool
    stop: threading.Event
    report: Reporter
    host: Host
    cost: Cost
    assessor: SetAssessor
    persistence: Persistence
    presence: Presence
    acquisition: SetAcquisition
    carried_over: CarriedOver
    unscheduled: UnscheduledSets
    commands: CommandExecutor
    clock_watch: ClockWatch
    self_calibration: SelfCalibration
    waiting: Waiting
    computer_load: ComputerLoadWatch | None


def assemble(
    settings: Settings,
    stores: Stores,
    rig: Rig,
    *,
    stop: threading.Event,
    report: Reporter,
    features_of: FeaturesOf = features_of,
    helpers: Helpers = NO_HELPERS,
    host: Host = THIS_COMPUTER,
) -> Parts:
    """Make the parts of a recorder; what the last one left is finished as far as it needs no strike."""
    presence: Presence
    commands: CommandExecutor
    archive, catalogue, cost = stores.archive, stores.catalogue, Cost()
    epoch_ns = catalogue.experiment_row().epoch_utc_ns
    sets = plan(settings.schedule.phases, epoch_ns, end_h=settings.schedule.end_h)
    refuse_foreign_open_sets(stores, sets)
    moment = partial(moment_at, rig.clock, epoch_ns)
    assessor = SetAssessor(settings, archive, catalogue, rig, cost, helpers.remote_drive, news=report)
    persistence = Persistence(
        stores,
        assessor,
        helpers,
        limit_bytes=settings.storage.memory_mb * 10**6,
        stop=stop,
        moment=moment,
        on_trouble=lambda: presence.beat(),  # noqa: PLW0108 - it is made below
        host=host,
    )
    presence = Presence(stores.heartbeat, persistence, report, answer_within_s=settings.rig.read_timeout_s)
    acquisition = SetAcquisition(
        settings,
        stores,
        rig,
        assessor,
        persistence,
        cost=cost,
        features_of=features_of,
        paused=lambda: commands.held,
    )
    carried_over = CarriedOver(tuple(settings.positions), stores, sets, assessor, persistence, acquisition)
    unscheduled = UnscheduledSets(sets, assessor, persistence, carried_over, moment, stop)
    drive = assessor.drive
    test = RunningTest(
        clock=rig.clock,
        moment=moment,
        stop=stop,
        alarms=assessor.alarms,
        annotations=lambda: catalogue.rows(AnnotationRow),
        store=assessor.commit,
        reinstated=assessor.reinstated,
        confirmation=unscheduled.request,
        settings=settings,
        next_set=lambda: unscheduled.next_set,
        baseline=catalogue.baseline,
        renewed=assessor.renewed,
        positions=settings.names_of(SOLITARY_WAVE),
        supply=drive if drive is not None and drive.has_supply else None,
    )
    commands = CommandExecutor(catalogue, test, listen_every_s=host.listen_every_s, adopt=assessor.adopt)
    clock_watch = ClockWatch(rig.clock, assessor, persistence, presence, moment, stop)
    rig.asking.listen(presence.report_request)
    return Parts(
        plan=sets, stores=stores, rig=rig, in_real_time=settings.clock.kind == "wall", stop=stop,
        report=report, host=host, cost=cost, assessor=assessor, persistence=persistence, presence=presence,
        acquisition=acquisition, carried_over=carried_over, unscheduled=unscheduled, commands=commands,
        clock_watch=clock_watch, self_calibration=SelfCalibration(rig, assessor, persistence, presence),
        waiting=Waiting(assessor, persistence, presence, clock_watch, commands, moment, stop),
        computer_load=helpers.machine,
    )  # fmt: skip
