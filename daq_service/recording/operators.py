"""What connects a recorder with people: their commands, and what an instrument asks them to do."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import AnnotationRow
from daq_service.commands.execution import CommandExecutor
from daq_service.commands.running_test import RunningTest
from daq_service.recording.acquire_set import Activity
from daq_service.recording.persistence import Persistence
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from daq_service.recording.waiting import Waiting
from hardware_drivers.measurement import ShotKey
from hardware_drivers.methods import SOLITARY_WAVE

ASKED, ASKED_OVER = "asked", "asked_over"
"""Events: a person is asked to do something now; that is done, or too late."""


def build_command_executor(resources: Resources, assessor: SetAssessor, waiting: Waiting) -> CommandExecutor:
    """Build the executor of operators' commands to this recorder, with access to its parts.

    No command is read or executed yet.
    """
    settings, catalogue, drive = resources.settings, resources.catalogue, assessor.drive
    test = RunningTest(
        clock=resources.rig.clock,
        moment=resources.moment,
        stop=resources.stop,
        alarms=assessor.alarms,
        annotations=lambda: catalogue.rows(AnnotationRow),
        store=assessor.commit,
        enabled=assessor.assessors.enable,
        confirmation=partial(_request_set, resources, assessor, waiting),
        settings=settings,
        next_set=lambda: waiting.next_set,
        baseline=catalogue.baseline,
        renewed=assessor.assessors.discard_state,
        positions=settings.list_positions(SOLITARY_WAVE),
        supply=drive if drive is not None and drive.has_supply else None,
    )
    return CommandExecutor(catalogue, test, adopt=assessor.adopt)


def _request_set(
    resources: Resources, assessor: SetAssessor, waiting: Waiting, position: str, author: str, note: str
) -> SetCommit:
    """Build the transaction with a person's request for an unscheduled set; the caller commits it.

    Raises
    ------
    ValueError
        It cannot be taken; contains the reason.
    """
    if waiting.newest is None:
        raise ValueError(
            "no scheduled set is complete, or none is left; an unscheduled set follows a scheduled one"
        )
    return assessor.confirmations.order(waiting.newest, position, author, note, resources.moment())


def listen_to_instruments(resources: Resources, persistence: Persistence, activity: Activity) -> None:
    """Show requests of instruments to a person from now on in the heartbeat, and store and report them."""

    def report(text: str, key: ShotKey | None) -> None:
        """Show a request in the heartbeat and store and report it as an event; an empty text ends it.

        ``key`` is the shot that waits for it; None: no shot.
        """
        activity.request = text and f"waiting for a person: {text}"
        # The record is waited for from here on, as long as the heartbeat's deadline allows.
        activity.beat(at_once=True)
        if not text:
            persistence.say(ASKED_OVER, {})
            resources.report(ASKED_OVER)
            return
        shot = {} if key is None else asdict(key)
        asked = {"text": text, **shot, "within_s": resources.settings.rig.read_timeout_s}
        persistence.say(ASKED, asked)
        resources.report(ASKED, **asked)

    resources.rig.asking.listen(report)
