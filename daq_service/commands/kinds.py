"""Commands to a running test: arguments, conditions and effect of each kind.

The web service and the command line check the arguments. The web service calls `Command.find_refusal` with
stored facts, the recorder with current ones. A new kind is a class in this package.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from daq_service.alarms import states
from daq_service.alarms.operator_actions import AFTER_ACKNOWLEDGEMENT, acknowledge_alarm, reset_alarm
from daq_service.alarms.process_trouble import CLOCK_UNVERIFIED
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, BaselineRow
from daq_service.clock import WallClock
from daq_service.settings.foreign_text import WRITTEN, require_visible_text
from simulator.clock import SimulatedClock

if TYPE_CHECKING:
    from daq_service.commands.running_test import PendingAnswer, RunningTest, StoredTest

LARGEST_ID = 2**53 - 1
LARGEST_HOUR = 1e7
Hour = Annotated[float, Field(ge=-LARGEST_HOUR, le=LARGEST_HOUR, allow_inf_nan=False)]

SEEN = {"pattern": WRITTEN.pattern}
Author = Annotated[
    str,
    Field(min_length=1, max_length=80, description="Person who gives the command", json_schema_extra=SEEN),
    AfterValidator(partial(require_visible_text, message="name the person who gives the command")),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """State of the test on which the rejection of a command depends.

    Attributes
    ----------
    recorder
        State by `processes.recorder_state`; in the recorder itself always ``running``.
    recorded
        The recorder's lock is held, or this is unknown.
    can_skip_time
        The test runs on a simulated clock; for the web service: on a paced one.
    paused
        Who paused the test and why; empty while it runs.
    positions
        The solitary-wave transducers.
    alarms
        Rows, with at least the newest of each position and kind.
    places
        Every position, of any method.
    annotations
        Rows.
    baselines
        The newest of each position that has one.
    """

    recorder: str = "running"
    recorded: bool = True
    can_skip_time: bool
    paused: str
    positions: Sequence[str]
    has_supply: bool
    alarms: Sequence[AlarmRow]
    places: Sequence[str] = ()
    annotations: Sequence[AnnotationRow] = ()
    baselines: Mapping[str, BaselineRow] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Rejection of a command, with reason and remedy.

    Attributes
    ----------
    reason
        The recorder's answer.
    hint
        Remedy, for clients of the web service.
    sentence
        Answer of the web service, if it differs from the reason.
    missing
        The object of the command does not exist.
    """

    reason: str
    hint: str
    sentence: str = ""
    missing: bool = False

    @property
    def detail(self) -> str:
        """Return the web service's answer: ``sentence``, else the reason as a sentence with a full stop."""
        return self.sentence or f"{self.reason[0].upper()}{self.reason[1:]}."


class Strict(BaseModel):
    """Refuses what it does not know, and takes no ``true`` for 1 V and no text for a number."""

    model_config = ConfigDict(extra="forbid", strict=True)


class NoArguments(Strict):
    """The command needs none."""


class NoteArguments(Strict):
    """Why; shown to everybody."""

    note: str = Field(default="", max_length=2000)


class AlarmArguments(NoteArguments):
    """Which alarm was seen."""

    alarm_id: int = Field(ge=1, le=LARGEST_ID)


class AnnotationArguments(Strict):
    """An instant or a range of hours, and what is to be known of it."""

    from_h: Hour = Field(description="First hour")
    to_h: Hour | None = Field(default=None, description="Last hour; null: an instant")
    position: str | None = Field(
        default=None, min_length=1, max_length=16, description="null: the complete test"
    )
    text: Annotated[
        str,
        Field(min_length=1, max_length=2000, json_schema_extra=SEEN),
        AfterValidator(partial(require_visible_text, message="write the note")),
    ]

    @model_validator(mode="after")
    def _check_range_order(self) -> Self:
        """Return the arguments; raise ValueError if the last hour is before the first one."""
        if self.to_h is not None and self.to_h < self.from_h:
            raise ValueError(f"the range ends at {self.to_h:g} h, before {self.from_h:g} h; let it end later")
        return self


class WithdrawalArguments(Strict):
    """Which annotation is no longer to be shown."""

    annotation_id: int = Field(ge=1, le=LARGEST_ID)


class ReasonArguments(Strict):
    """Why; shown to everybody for as long as it lasts."""

    note: Annotated[
        str,
        Field(min_length=1, max_length=2000, json_schema_extra=SEEN),
        AfterValidator(
            partial(require_visible_text, message="state why the test is paused, such as 'hands in the rig'")
        ),
    ]


class TransducerArguments(NoteArguments):
    """Which transducer, and why."""

    position: str = Field(min_length=1, max_length=16)


class SupplyArguments(NoteArguments):
    """Voltage and current limit; null: as configured. Beyond the configured caps the recorder refuses."""

    voltage_v: float | None = Field(default=None, gt=0.0, le=60.0)
    current_limit_a: float | None = Field(default=None, gt=0.0, le=100.0)


class CommandRejectedError(ValueError):
    """Error of a command that cannot be executed now, with its ``refusal``."""

    def __init__(self, refusal: Refusal) -> None:
        """Store the refusal; its reason becomes the text of the error."""
        super().__init__(refusal.reason)
        self.refusal = refusal


class Command(Strict):
    """What a person asks of a test."""

    needs_recorder: ClassVar[bool] = True
    rows_only: ClassVar[bool] = False
    """It only stores one transaction, which contains its answer."""
    kind: str
    author: Author = "operator"
    arguments: Any = NoArguments()

    def find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal of the command in this state of the test; None if it can be executed.

        A command that needs a recorder is refused if none holds the lock, or if the recorder has finished or
        stopped; each kind adds its own conditions.
        """
        ended = f"the recorder has {facts.recorder}" if facts.recorder in {"finished", "stopped"} else ""
        if self.needs_recorder and (ended or not facts.recorded):
            return Refusal(
                f"{ended or 'no recorder runs for this test'}: no recorder would execute this",
                "Start it with `solimon run` or `solimon record`, then send the command again.",
            )
        return self._find_refusal(facts)

    def carry_out(self, test: RunningTest, order_id: int, facts: Facts) -> str | PendingAnswer:
        """Execute the command; return its result as text, or a function that polls an instrument for it.

        Raises
        ------
        CommandRejectedError
            The facts do not allow the command; nothing was changed.
        ValueError
            The command was not executed, with the reason.
        """
        self.require_allowed(facts)
        return self._carry_out(test, order_id)

    def require_allowed(self, facts: Facts) -> None:
        """Raise an error if these facts do not allow the command; otherwise do nothing.

        Raises
        ------
        CommandRejectedError
            The command cannot be executed; the error has the refusal.
        """
        refusal = self.find_refusal(facts)
        if refusal is not None:
            raise CommandRejectedError(refusal)

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal that is specific to this kind; None allows the command, as by default."""
        return None

    def _carry_out(self, test: RunningTest, order_id: int) -> str | PendingAnswer:
        """Execute an allowed command; return its result as text, or a function that polls for it.

        Each kind implements it; the default raises NotImplementedError.
        """
        raise NotImplementedError


class FinishNow(Command):
    """Stop pacing: the rest of the simulated test runs as fast as it goes."""

    kind: Literal["finish_now"]
    arguments: NoArguments = NoArguments()

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal unless the test's clock can skip time (simulated and paced); else None."""
        if facts.can_skip_time:
            return None
        return Refusal(
            "the test runs on the wall clock, which cannot skip time",
            "finish_now belongs to a simulated clock with clock.pace_h_per_s, as in `solimon demo`.",
            "This test is not paced: it already runs as fast as its clock allows.",
        )

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """End the pacing of the simulated clock from now on; return the result as text."""
        assert isinstance(test.clock, SimulatedClock), "another clock forbids it"
        test.clock.finish_now()
        return "no pacing from here on"


class Stop(Command):
    """End the recording after the current set."""

    kind: Literal["stop"]
    arguments: NoArguments = NoArguments()

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Set the recorder's stop request and return the result as text at once.

        The recorder ends after the shot being taken.
        """
        test.stop.set()
        return "stopping after the shot being taken"


class StoredCommand(Command):
    """Command about what is stored; without a recorder the web service executes it."""

    needs_recorder = False
    rows_only = True

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Execute the command as `carry_out_stored` does, here in the recorder; return its result as text."""
        return self.carry_out_stored(test)

    def carry_out_stored(self, test: StoredTest) -> str:
        """Execute an allowed command in one transaction, also without a recorder; return the result as text.

        Each kind implements it; the default raises NotImplementedError.
        """
        raise NotImplementedError


class AcknowledgeAlarm(StoredCommand):
    """An operator has seen an alarm."""

    kind: Literal["acknowledge_alarm"]
    arguments: AlarmArguments

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal of an unknown alarm, or of one whose state cannot be acknowledged; else None.

        An unknown alarm is marked as ``missing``.
        """
        wanted = self.arguments.alarm_id
        state = next((row.state for row in facts.alarms if row.id == wanted), None)
        if state in AFTER_ACKNOWLEDGEMENT:
            return None
        if state is None:
            reason, sentence = f"there is no current alarm {wanted}", f"There is no alarm {wanted}."
            return Refusal(reason, "/api/v1/alarms lists them.", sentence, missing=True)
        return Refusal(
            f"alarm {wanted} is {state}: there is nothing to acknowledge",
            f"Only alarms that are {' or '.join(AFTER_ACKNOWLEDGEMENT)} wait for an operator.",
        )

    def carry_out_stored(self, test: StoredTest) -> str:
        """Store the alarm as acknowledged by the author, with its event; return ``acknowledged``."""
        (row,) = (row for row in test.alarms.values() if row.id == self.arguments.alarm_id)
        moment = test.moment()
        test.store_alarm_changes(moment, acknowledge_alarm(row, self.author, self.arguments.note, moment))
        return "acknowledged"


class Pause(Command):
    """Pause striking until the test is resumed, also after a restart."""

    rows_only = True
    kind: Literal["pause"]
    arguments: ReasonArguments

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal if the test is paused already; None if it is not."""
        reason = f"the test is already {facts.paused}"
        return Refusal(reason, "Resume it first; a pause has one reason.") if facts.paused else None

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Store the event that pauses the test, with author and reason; return the result as text.

        The pause lasts over restarts until `Resume`.
        """
        text = f"paused by {self.author}: {self.arguments.note}"
        test.store_event("pause", {"paused": text, "author": self.author})
        return "paused: nothing strikes until the test is resumed; due sets are missed"


class Resume(Command):
    """Resume a paused test with the next due set."""

    rows_only = True
    kind: Literal["resume"]
    arguments: NoteArguments = NoteArguments()

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal if the test is not paused; None if it is."""
        hint = "Only a paused test can be resumed."
        return None if facts.paused else Refusal("the test is not paused", hint)

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Store the event that ends the pause, with author and note; return the result as text."""
        test.store_event("resume", {"paused": "", "author": self.author, "note": self.arguments.note})
        return "resumed: the next due set is taken"


class TrustClock(Command):
    """Trust the computer clock and continue the test."""

    kind: Literal["trust_clock"]
    arguments: NoteArguments = NoteArguments()

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal unless alarm ``clock_unverified`` is active, acknowledged or not; else None."""
        standing = ("unacknowledged", "acknowledged")
        if any(row.kind == CLOCK_UNVERIFIED and row.state in standing for row in facts.alarms):
            return None
        return Refusal(
            "the computer clock is verified", "The alarm clock_unverified is active while it is not."
        )

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Accept the computer's UTC as test time; return the result as text.

        Raise ValueError if the clock is verified already.
        """
        assert isinstance(test.clock, WallClock), "no other clock is doubted"
        return test.clock.accept_system_clock()


class TransducerCommand(Command):
    """About a solitary-wave transducer."""

    rows_only = True
    arguments: TransducerArguments

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal of an unknown transducer, else what `_find_refusal_at` returns for its state.

        None allows the command; only solitary-wave transducers are known.
        """
        position = self.arguments.position
        if position not in facts.positions:
            missing = f"there is no solitary-wave transducer {position!r}"
            names = f"there are: {', '.join(facts.positions) or 'none'}"
            return Refusal(f"{missing}; {names}", f"T{names[1:]}.", f"T{missing[1:]}.")
        return self._find_refusal_at(position, states.find_disabled(facts.alarms).get(position))

    def _find_refusal_at(self, position: str, disabled: str | None) -> Refusal | None:
        """Return the refusal of a disabled position; None if it is enabled. Kinds may override it.

        ``disabled`` is the reason why it is disabled; None: it is enabled.
        """
        reason, hint = f"{position} is disabled", "Enable it when it is repaired."
        return None if disabled is None else Refusal(reason, hint, f"{reason}: {disabled}.")


class Disable(TransducerCommand):
    """Stop striking one transducer until it is enabled; the others continue."""

    kind: Literal["disable"]

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Store a latched alarm ``transducer_disabled`` for the position; return the result as text."""
        position, moment = self.arguments.position, test.moment()
        condition = states.Condition(
            position=position,
            kind="transducer_disabled",
            priority="medium",
            present=True,
            latched=True,
            evidence={
                "command_id": order_id,
                "author": self.author,
                "note": self.arguments.note or "no reason given",
            },
        )
        change = states.update_alarm(test.alarms.get((position, "transducer_disabled")), condition, moment)
        assert change is not None, "a position that is not disabled has no such active alarm"
        test.store_alarm_changes(moment, change)
        return f"{position} is disabled"


class Enable(TransducerCommand):
    """Enable a disabled transducer from the next set."""

    kind: Literal["enable"]

    def _find_refusal_at(self, position: str, disabled: str | None) -> Refusal | None:
        """Return the refusal of a position that is enabled (``disabled`` is None); None if it is disabled."""
        reason, hint = f"{position} is not disabled", "/api/v1/transducers lists which are, and why."
        return Refusal(reason, hint) if disabled is None else None

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Reset the alarms that disable the transducer, store them, and enable it; return the result as text.

        It strikes from the next set on.
        """
        position, moment = self.arguments.position, test.moment()
        standing = [
            row
            for (place, kind), row in test.alarms.items()
            if place == position and kind in states.RETIRING and row.state != "normal"
        ]
        changes = [reset_alarm(row, self.author, self.arguments.note, moment) for row in standing]
        test.store_alarm_changes(moment, *changes)
        test.enabled(position)
        return f"{position} strikes again from the next set"


class Strike(TransducerCommand):
    """Take one unscheduled set at a transducer, outside control chart and baseline."""

    kind: Literal["strike"]

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal if the test is paused or the transducer unknown or disabled; None allows it."""
        if facts.paused:
            reason = f"the test is {facts.paused}"
            return Refusal(reason, "Resume it when all hands are out of the rig.")
        return super()._find_refusal(facts)

    def _carry_out(self, test: RunningTest, order_id: int) -> str:
        """Store the request for an unscheduled set at the position; return the result as text.

        The set is taken later. Raise ValueError if such a set cannot be requested.
        """
        position = self.arguments.position
        reason = self.arguments.note or f"requested by {self.author}"
        test.store(test.confirmation(position, self.author, reason))
        return f"an unscheduled set is taken at {position} as soon as the recorder is free"


class _SupplyCommand(Command):
    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal if the test has no supply; None if it has one."""
        if facts.has_supply:
            return None
        return Refusal(
            "this test has no supply; configure [rig.supply]",
            "Configure [rig.supply] and restart the test.",
            "This test has no supply.",
        )


class SupplyOn(_SupplyCommand):
    """Switch the corrosion drive on; only a person's command does."""

    kind: Literal["supply_on"]
    author: Author
    arguments: SupplyArguments = SupplyArguments()

    def _carry_out(self, test: RunningTest, order_id: int) -> PendingAnswer:
        """Send the command on to the supply without waiting; return a function that polls for its answer.

        ValueError if the supply rejects it, here or from that function. None: values as configured.
        """
        volts, amperes = self.arguments.voltage_v, self.arguments.current_limit_a
        return test.switch.supply_on(
            self.author, test.moment().due_h, voltage_v=volts, current_limit_a=amperes
        )


class SupplyOff(_SupplyCommand):
    """Switch the corrosion drive off."""

    kind: Literal["supply_off"]
    arguments: NoteArguments = NoteArguments()

    def _carry_out(self, test: RunningTest, order_id: int) -> PendingAnswer:
        """Send the command off to the supply without waiting; return a function that polls for its answer.

        ValueError if the supply rejects it, here or from that function.
        """
        return test.switch.supply_off(self.author, test.moment().due_h)


class Annotate(StoredCommand):
    """Note something of an hour of the test, or of a range."""

    kind: Literal["annotate"]
    arguments: AnnotationArguments

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal of an unknown position (``missing``); None for a known one or the whole test."""
        position = self.arguments.position
        if position is None or position in facts.places:
            return None
        return Refusal(
            f"there is no position {position!r}",
            f"The positions are {', '.join(facts.places)}; leave it out for the complete test.",
            missing=True,
        )

    def carry_out_stored(self, test: StoredTest) -> str:
        """Store the annotation with its event, in one transaction; return ``noted``.

        An annotation of an instant gets equal first and last hours.
        """
        arguments = self.arguments
        row = AnnotationRow(
            position=arguments.position,
            from_h=arguments.from_h,
            to_h=arguments.from_h if arguments.to_h is None else arguments.to_h,
            text=arguments.text.strip(),
            author=self.author,
            written_utc_ns=test.moment().utc_ns,
        )
        test.store_annotation(row, "annotation_added")
        return "noted"


class WithdrawAnnotation(StoredCommand):
    """Take an annotation back; it stays in the catalogue, with who withdrew it."""

    kind: Literal["withdraw_annotation"]
    arguments: WithdrawalArguments

    def _find_refusal(self, facts: Facts) -> Refusal | None:
        """Return the refusal of an annotation that is unknown (``missing``) or was withdrawn; else None."""
        wanted = self.arguments.annotation_id
        row = next((row for row in facts.annotations if row.id == wanted), None)
        if row is None:
            return Refusal(
                f"there is no annotation {wanted}", "/api/v1/annotations lists them.", missing=True
            )
        if row.withdrawn_utc_ns is None:
            return None
        return Refusal(
            f"annotation {wanted} was withdrawn by {row.withdrawn_by} already",
            "Note it again if it is still true.",
        )

    def carry_out_stored(self, test: StoredTest) -> str:
        """Store time and author of the withdrawal, with its event; return ``withdrawn``. The row is kept."""
        (row,) = (row for row in test.annotations() if row.id == self.arguments.annotation_id)
        withdrawn = replace(row, withdrawn_utc_ns=test.moment().utc_ns, withdrawn_by=self.author)
        test.store_annotation(withdrawn, "annotation_withdrawn")
        return "withdrawn"
