"""Models of the answers of a service of several tests."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from daq_service.assessment.position_status import PositionStatus
from daq_service.catalogue.rows import Priority
from daq_service.processes.recorder_state import RecorderStatus
from daq_service.web.answers.models import Answer, Liveness, PositionStanding
from daq_service.web.multi_test.location import Absence


class Standing(Answer):
    """Present state of a test that can be shown."""

    rig: str = Field(description="Kind of the rig")
    rig_label: str = Field(description="The same for a person; a twin is a simulation")
    clock: Literal["simulated", "wall"] = Field(description="Which clock the test runs on")
    epoch_utc: str = Field(description="Hour 0 of the test, RFC 3339")
    now_h: float = Field(description="Now on the test's clock, in h since its hour 0")
    end_h: float = Field(description="Hour of the last planned set, h")
    recorder: RecorderStatus = Field(description="How the recorder is")
    wall_age_s: float | None = Field(description="Time since the recorder wrote, s; null: it never did")
    held: str | None = Field(description="Who holds the test and why; null: nobody does")
    state: PositionStatus = Field(description="The gravest state of its positions")
    stale: bool = Field(description="The data of a position are older than the cadence explains")
    active_alarms: int = Field(description="Alarms that are not over, a count")
    highest_priority: Priority | None = Field(description="Of these; null: there are none")
    last_set_index: int | None = Field(description="Index of the newest measured set; null: there is none")
    last_set_h: float | None = Field(description="When it was due, in h since hour 0")
    age_h: float | None = Field(description="Its age on the test's clock, h")
    positions: list[PositionStanding] = Field(description="The monitored places")


class ListedTest(Answer):
    """Test of this service, also one that cannot be shown."""

    test: str = Field(description="Its name in addresses")
    name: str = Field(description="The experiment's; while that cannot be read, the folder's or file's")
    source: str = Field(description="Configuration or data folder that the service was started with")
    page: str = Field(description="Address of its page")
    api: str = Field(description="Address of its interface")
    state: Literal["shown"] | Absence = Field(
        description="`shown`, or why not: nothing recorded yet, folder not there, none of solimon's, "
        "configuration refused, damaged, of another version, locked by tokens of its own, not readable"
    )
    detail: str | None = Field(description="What is the matter; null: nothing")
    remedy: str | None = Field(description="What helps; null: nothing is the matter")
    standing: Standing | None = Field(description="null: it cannot be shown")
    looked_age_s: float = Field(description="Time since this entry was read, s")


class ListedTests(Answer):
    """Tests in the order of the command line."""

    items: list[ListedTest] = Field(description="One entry a test")


class ServiceLiveness(Liveness):
    """The process of the service answers; ready where at least one test can be shown."""

    tests: int = Field(description="ServedTests of this service, a count")
    shown: int = Field(description="Those that can be shown, as last looked at, a count")
