"""Heartbeat of the recorder, written by the recording thread and read by supervisor, web and commands.

The web service has a heartbeat, too, written by its event loop.

The file has a fixed size and is overwritten in place at most twice a second and when the activity changes: it
works on a full disk, no rename collides with a reader, and a read during a write fails its checksum. It is a
hint; the supervisor gets the same on its pipe. Its age is measured on the machine's monotonic clock, so a
step of UTC neither kills nor hides a recorder; that clock restarts with each boot, so the file names the
boot.
"""

from __future__ import annotations

import json
import logging
import os
import time
import zlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from daq_service.clock import MACHINE, MachineClock, TimeLine, boot_name
from daq_service.shared_file import O_BINARY, read_best_effort
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

FILE_NAME, WEB_FILE = "heartbeat.json", "web_heartbeat.json"
"""Heartbeat files of the recorder and of the web service."""
WEB_BEATS_EVERY_S, WEB_DEADLINE_S = 1.0, 15.0
"""Garbage collection and replays block the event loop for a fraction of a second."""
WEB_STARTS_WITHIN_S, WEB_ANSWERS_WITHIN_S = 60.0, 3.0
"""Time for a restart of the web service after a crash of computer or recorder, and for all processes to
continue after the computer was asleep."""
FILE_BYTES = 4096
LONGEST_DOING = 500
"""Characters, which take six bytes each at most."""
LOOKS = 3
"""Two writes are at least half a second or 100 write times apart: one of this many reads meets none."""
SHORTEST_INTERVAL_NS = 500_000_000

CHANGE_INTERVAL_COSTS = 100
"""A new activity is written at once, unless the last change is younger than this many times the cost of a
beat: also in a fast simulated test, beats take at most a hundredth of the time."""


Stage = Literal["", "opening", "ended"]
"""Stage of a recorder: at work, opening its rig (no commands yet), or ended (also while it lingers)."""
WebState = Literal["responding", "not_responding", "not_expected"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Beat:
    """Content of the heartbeat file.

    Attributes
    ----------
    boot
        Name of the boot that ``mono_ns`` counts in; None where it has none (`clock.boot_name`).
    utc_ns, elapsed_ns
        A moment of a test in real time: its time, and the elapsed time of the boot, sleep included. None on
        a simulated clock, while the clock is unverified, and in the file of an older version.
    stage
        Distinguishes a recorder that starts from one that ends: the newest event of both is the same.
    pace_h_per_s
        Pace of a simulated clock that does not keep the set one; else None.
    """

    process: int
    mono_ns: int
    deadline_s: float
    doing: str
    boot: str | None = None
    utc_ns: int | None = None
    elapsed_ns: int | None = None
    stage: Stage = ""
    pace_h_per_s: float | None = None


class Heartbeat:
    """Writer of the heartbeat, to the file and to a callback.

    Parameters
    ----------
    deadline_s
        Longest time between two beats of a healthy recorder: its longest bounded call and a margin.
    notify
        Called with the name of the event, ``beat``, and the values of a `Beat`.
    time_line
        The test's time at this moment; None where it is unknown.
    pace
        Content of `Beat.pace_h_per_s` at this moment.

    Attributes
    ----------
    stage
        Written with every beat from now on.
    """

    def __init__(
        self,
        folder: Path,
        *,
        deadline_s: float,
        notify: Callable[..., None] = lambda event, **values: None,
        machine: MachineClock = MACHINE,
        time_line: Callable[[], TimeLine | None] = lambda: None,
        pace: Callable[[], float | None] = lambda: None,
        file: str = FILE_NAME,
    ) -> None:
        self.stage: Stage = ""
        self._path = folder / file
        self._deadline_s = deadline_s
        self._notify = notify
        self._machine, self._boot = machine, machine.boot_name()
        self._time_line, self._pace = time_line, pace
        self._last_ns: int | None = None
        self._last_change_ns: int | None = None
        self._last_cost_ns = 0
        self._last_doing = ""

    def beat(self, doing: str, *, at_once: bool = False) -> None:
        """Send a heartbeat with the present activity, truncated to 500 characters, to callback and file.

        Skipped within 0.5 s of the last one, and for a new activity within 100 times the cost of a beat;
        ``at_once`` sends always (a long wait starts). A file that cannot be written is logged once.
        """
        doing = doing[:LONGEST_DOING]
        now_ns = self._machine.mono_ns()
        is_change = doing != self._last_doing
        last_ns = self._last_change_ns if is_change else self._last_ns
        pause_ns = CHANGE_INTERVAL_COSTS * self._last_cost_ns if is_change else SHORTEST_INTERVAL_NS
        if not at_once and last_ns is not None and now_ns - last_ns < min(pause_ns, SHORTEST_INTERVAL_NS):
            return
        time_line = self._time_line()
        beat = Beat(
            process=os.getpid(),
            mono_ns=now_ns,
            deadline_s=self._deadline_s,
            doing=doing,
            boot=self._boot,
            utc_ns=None if time_line is None else time_line.utc_ns,
            elapsed_ns=None if time_line is None else time_line.elapsed_ns,
            stage=self.stage,
            pace_h_per_s=self._pace(),
        )
        self._notify("beat", **asdict(beat))
        try:
            _overwrite_file(self._path, encode_heartbeat(beat))
        except OSError as error:
            _warn_once(self._path, f"cannot be written ({error}); the supervisor still receives it")
        self._last_ns, self._last_doing = now_ns, doing
        self._last_change_ns = now_ns if is_change else self._last_change_ns
        self._last_cost_ns = self._machine.mono_ns() - now_ns


def encode_heartbeat(beat: Beat) -> bytes:
    """Encode a heartbeat as JSON with its CRC-32, padded with spaces to `FILE_BYTES` (4096) bytes."""
    values = asdict(beat)
    return json.dumps({**values, "crc32": _compute_crc32(values)}).encode().ljust(FILE_BYTES)


def _compute_crc32(values: Mapping[str, Any]) -> int:
    """Compute the CRC-32 of values in their order, encoded as JSON."""
    return zlib.crc32(json.dumps(values).encode())


def _overwrite_file(path: Path, content: bytes) -> None:
    """Write the content over the start of a file without truncating it; create a missing file.

    Raises OSError if it cannot be opened or written.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | O_BINARY, 0o644)
    try:
        os.write(descriptor, content)
    finally:
        os.close(descriptor)


def read_heartbeat(folder: Path, file: str = FILE_NAME) -> Beat | None:
    """Read the newest heartbeat from a file of the folder, in up to 3 reads without a pause.

    Returns None without a readable file, or, with a warning (once for each problem), if all reads are
    invalid.
    """
    path = folder / file
    reason = ""
    for _ in range(LOOKS):
        content = read_best_effort(path)
        if content is None:
            return None
        try:
            return _decode_heartbeat(content)
        except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
            # A power cut may leave it empty or torn: that counts as no heartbeat.
            reason = f"{type(error).__name__}: {error}"
    _warn_once(path, f"is no heartbeat and counts as none: {reason}")
    return None


def _decode_heartbeat(content: bytes) -> Beat:
    """Decode the JSON content of a heartbeat file.

    Raises ValueError if it is no JSON or its checksum is wrong, AttributeError if it is no object, or the
    errors of `parse_beat`. Files of earlier versions have no checksum.
    """
    values = json.loads(content)
    crc32 = values.pop("crc32", None)  # an older version wrote none
    if crc32 is not None and crc32 != _compute_crc32(values):
        raise ValueError("its checksum is wrong")
    return parse_beat(values)


def parse_beat(values: Mapping[str, Any]) -> Beat:
    """Convert the values of a heartbeat message to a `Beat`.

    Raises
    ------
    ValueError, TypeError, LookupError, OverflowError
        The values are not those of a beat.
    """
    return Beat(
        process=int(values["process"]),
        mono_ns=int(values["mono_ns"]),
        deadline_s=float(values["deadline_s"]),
        doing=str(values["doing"]),
        boot=values.get("boot"),
        utc_ns=_parse_optional_int(values.get("utc_ns")),
        elapsed_ns=_parse_optional_int(values.get("elapsed_ns")),
        stage=values.get("stage", ""),
        pace_h_per_s=values.get("pace_h_per_s"),
    )


def _parse_optional_int(value: Any) -> int | None:
    """Convert a value to an integer; None stays None."""
    return None if value is None else int(value)


@lru_cache(maxsize=8)
def _warn_once(path: Path, problem: str) -> None:
    """Log a warning once for each problem (of the latest 8), since the file is read many times a second."""
    log.warning("%s %s", path, problem)


def compute_beat_age_s(beat: Beat, *, boot: str | None, mono_ns: int) -> float | None:
    """Return the age of a beat, s, at a monotonic time of a boot; None if it was written in another boot.

    If one of the two boot names is missing (`clock.boot_name`, or a file of an earlier version), only a beat
    later than ``mono_ns`` counts as one of another boot.
    """
    other_boot = None not in (beat.boot, boot) and beat.boot != boot
    return None if other_boot or beat.mono_ns > mono_ns else (mono_ns - beat.mono_ns) / NS_PER_S


def create_web_beat() -> Beat:
    """Create a heartbeat of the web service in this process, for its supervisor; its deadline is 15 s."""
    now_ns = time.monotonic_ns()
    return Beat(process=os.getpid(), mono_ns=now_ns, deadline_s=WEB_DEADLINE_S, doing="serving")


def read_web_state(folder: Path, *, machine: MachineClock = MACHINE) -> WebState:
    """Read from its heartbeat file whether the web service of a folder responds.

    Returns ``responding``; ``not_expected`` if it never ran or has ended in order; or ``not_responding`` if
    its heartbeat is past its deadline or of another boot.
    """
    beat = read_heartbeat(folder, WEB_FILE)
    if beat is None or beat.stage == "ended":
        return "not_expected"
    age = compute_beat_age_s(beat, boot=boot_name(), mono_ns=machine.mono_ns())
    return "responding" if age is not None and age <= beat.deadline_s else "not_responding"


class WebWatch:
    """Monitor that confirms whether the web service of a folder responds."""

    def __init__(self, folder: Path, *, machine: MachineClock = MACHINE) -> None:
        self._folder, self._machine = folder, machine
        self._next_ns = machine.mono_ns()
        self._until_ns: float | None = self._next_ns + WEB_STARTS_WITHIN_S * NS_PER_S

    def is_missing(self) -> bool | None:
        """Return whether the web service has been ``not_responding`` for 3 s (60 s after the watch starts).

        None if that is not confirmed yet, or if the last check was less than 1 s ago.
        """
        now_ns = self._machine.mono_ns()
        if now_ns < self._next_ns:
            return None
        self._next_ns = now_ns + NS_PER_S
        if read_web_state(self._folder, machine=self._machine) != "not_responding":
            self._until_ns = None
            return False
        self._until_ns = self._until_ns or now_ns + WEB_ANSWERS_WITHIN_S * NS_PER_S
        return True if now_ns >= self._until_ns else None


def extract_time_line(beat: Beat | None, *, boot: str | None, elapsed_ns: int) -> TimeLine | None:
    """Return the pair of test time (ns of UTC) and elapsed boot time (ns) in a beat.

    None without a beat, without these times, or if the beat is not of this boot: ``boot`` is its name and
    ``elapsed_ns`` its present elapsed time.
    """
    if beat is None or beat.utc_ns is None or beat.elapsed_ns is None:
        return None
    if beat.boot is None or beat.boot != boot or beat.elapsed_ns > elapsed_ns:
        return None
    return TimeLine(utc_ns=beat.utc_ns, elapsed_ns=beat.elapsed_ns)


def compute_test_time_ns(beat: Beat | None, *, machine: MachineClock = MACHINE) -> int | None:
    """Return the present time of a test in real time, ns of UTC; None if no recorder of this boot reports it.

    It may differ from the system time, which may have been set since.
    """
    now_ns = machine.elapsed_ns()
    time_line = extract_time_line(beat, boot=machine.boot_name(), elapsed_ns=now_ns)
    return None if time_line is None else time_line.utc_ns + now_ns - time_line.elapsed_ns
