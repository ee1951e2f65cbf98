"""Models of the answers of a service of several tests."""

from __future__ import annotations

from typing import Literal

from daq_service.assessment.position_status import PositionStatus
from daq_service.catalogue.rows import Priority
from daq_service.processes.recorder_state import RecorderStatus
from daq_service.web.answers.models import Answer, Liveness, PositionStanding
from daq_service.web.multi_test.location import Absence


class Standing(Answer):
    """Present state of a test that can be shown."""

    rig: str
    rig_label: str
    clock: Literal["simulated", "wall"]
    epoch_utc: str
    now_h: float
    end_h: float
    recorder: RecorderStatus
    wall_age_s: float | None
    paused: str | None
    state: PositionStatus
    stale: bool
    active_alarms: int
    highest_priority: Priority | None
    last_set_index: int | None
    last_set_h: float | None
    age_h: float | None
    positions: list[PositionStanding]


class ListedTest(Answer):
    """Test of this service, also one that cannot be shown."""

    test: str
    name: str
    source: str
    page: str
    api: str
    state: Literal["shown"] | Absence
    detail: str | None
    remedy: str | None
    standing: Standing | None
    looked_age_s: float


class ListedTests(Answer):
    """Tests in the order of the command line."""

    items: list[ListedTest]


class ServiceLiveness(Liveness):
    """The process of the service answers; ready where at least one test can be shown."""

    tests: int
    shown: int
