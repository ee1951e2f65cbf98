"""Ask questions at the terminal and on the page; the first answer counts."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal, TextIO, TypeVar

import click

from daq_service.errors import UsageError

T = TypeVar("T")

LOOK_S = 0.5
"""Ctrl-C is seen this late at most: on Windows it wakes no thread that waits for another."""
KEPT_LINES = 500


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A question to a person.

    Attributes
    ----------
    name
        Of the value, for programs: ``B.input``.
    default
        What no answer means.
    choices
        What may be answered; empty: anything that is understood.
    """

    name: str
    text: str
    default: str = ""
    choices: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class _Answer:
    """Text (None at the terminal's end), and the question that it answers (None: the next one)."""

    text: str | None
    number: int | None = None
    source: Literal["terminal", "page"] = "terminal"


@dataclass(slots=True)
class Dialogue:
    """A dialogue with one person, at the terminal or on the page.

    Attributes
    ----------
    lines
         All reported lines.
    number
        Of the question that waits: an answer to an earlier one is none to this.
    """

    lines: list[str] = field(default_factory=list)
    number: int = 0
    _waiting: Question | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _answers: queue.Queue[_Answer] = field(default_factory=queue.Queue)
    _reads: bool = False

    def report(self, text: str = "") -> None:
        """Print a line on standard error and keep it for the page, which shows the last `KEPT_LINES`.

        Standard output may be read by a program.
        """
        click.echo(text, err=True)
        self.lines = [*self.lines, text][-KEPT_LINES:]

    def ask(
        self,
        name: str,
        text: str,
        parse: Callable[[str], T],
        *,
        default: str = "",
        choices: Sequence[str] = (),
    ) -> T:
        """Ask a question until an answer is valid, and return the parsed answer; blocks without limit.

        The first answer counts, from the terminal or the page; an empty one means ``default``.

        Parameters
        ----------
        parse
            Convert the answer to a value, or raise ValueError with what is wrong, which is printed.
        choices
            Permitted answers; empty: any.

        Raises
        ------
        UsageError
            The terminal's answers have ended.
        """
        question = Question(name=name, text=text, default=default, choices=choices)
        listed, usual = f" ({', '.join(choices)})" if choices else "", f" [{default}]" if default else ""
        try:
            while True:
                with self._lock:
                    self.number += 1
                    self._waiting = question
                self._start_terminal_reader()
                click.echo(f"{text}{listed}{usual}: ", nl=False, err=True)
                answer = self._wait_for_next_answer(question) or default
                try:
                    if choices and answer not in choices:
                        raise ValueError(f"{answer!r} is none of {', '.join(choices)}")
                    value = parse(answer)
                except ValueError as error:
                    self.report(f"  {error}")
                    continue
                self.lines = [*self.lines, f"{text}: {answer}"]
                return value
        finally:
            with self._lock:
                self._waiting = None

    def ask_yes_or_no(self, name: str, text: str, *, default: str) -> bool:
        """Ask a question with the choices yes and no; return True for yes. Blocks and raises as `ask`."""
        return self.ask(name, text, lambda answer: answer == "yes", default=default, choices=("yes", "no"))

    def answer(self, number: int, text: str) -> bool:
        """Queue an answer of the page; return False if question ``number`` does not wait now."""
        with self._lock:
            if self._waiting is None or number != self.number:
                return False
        self._answers.put(_Answer(text, number, "page"))
        return True

    def as_row(self) -> Mapping[str, object]:
        """Convert the state to a JSON object for the page: the waiting question or None, and the lines."""
        with self._lock:
            waiting, number = self._waiting, self.number
        question = None if waiting is None else {"number": number, **asdict(waiting)}
        return {"question": question, "lines": self.lines}

    def _wait_for_next_answer(self, question: Question) -> str:
        """Wait without limit for the next answer to this question and return it without outer spaces.

        Answers to earlier questions are dropped. Raises UsageError at the end of the terminal's input.
        """
        while True:
            try:
                answer = self._answers.get(timeout=LOOK_S)
            except queue.Empty:
                continue
            if answer.text is None:
                click.echo(err=True)
                raise UsageError(
                    f"no answer is left ({question.name}: {question.text}); answer at a terminal, or "
                    "give flags: solimon setup --help"
                )
            if answer.number is not None and answer.number != self.number:
                continue
            if answer.source == "page":
                click.echo(f"{answer.text} (on the page)", err=True)
            return answer.text.strip()

    def _start_terminal_reader(self) -> None:
        """Start the daemon thread that reads standard input, once only."""
        if not self._reads:
            self._reads = True
            threading.Thread(
                target=self._queue_lines, args=(sys.stdin,), name="terminal", daemon=True
            ).start()

    def _queue_lines(self, stream: TextIO) -> None:
        """Add the lines of a stream to the queue of answers until it ends (body of the reading thread).

        A typed line answers only the question shown at that time; a piped one answers the next.
        """
        typed = stream.isatty()
        for line in stream:
            # What a person typed to an earlier question, or while the rig was at work, answers no later one.
            self._answers.put(_Answer(line, self.number if typed else None))
        self._answers.put(_Answer(None))
