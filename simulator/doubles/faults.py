"""Faults on request: any call can fail, hang, lie, or end the process."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from simulator.doubles.vendor_api.attributes import ATTRIBUTES
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, HANDLE, EntryPoint, Parameter, Role
from simulator.doubles.vendor_api.wire import list_outputs

FaultKind = Literal["error", "hang", "lie", "death"]
KINDS: tuple[FaultKind, ...] = ("error", "hang", "lie", "death")


@dataclass(slots=True, eq=False)
class Fault:
    """Requested fault.

    Attributes
    ----------
    function
        C name, or ``<C name>:<attribute>`` such as ``DAQmxGetTimingAttribute:SampClk.Rate``.
    code
        Status of an ``error``.
    skip
        Matching calls that still go through unharmed.
    times
        Calls it strikes from then on; 0: every one.
    seconds
        How long a ``hang`` lasts; None: until released.
    """

    function: str
    kind: FaultKind
    code: int
    skip: int
    times: int
    seconds: float | None


class Faults:
    """Pending faults."""

    def __init__(self) -> None:
        self._orders: list[Fault] = []
        self._lock = threading.Lock()
        self._released = threading.Condition(self._lock)
        self._release_count = 0
        self._hanging = 0

    @property
    def hanging(self) -> int:
        """Return the number of calls that hang now."""
        with self._lock:
            return self._hanging

    def inject(
        self,
        function: str,
        kind: str,
        *,
        code: int | None = None,
        nth: int = 1,
        times: int = 1,
        seconds: float | None = None,
    ) -> None:
        """Request a fault for ``times`` calls of a function, from the nth call from now on.

        Parameters
        ----------
        function
            C name, or ``<C name>:<attribute>``.
        kind
            ``error``, ``hang``, ``lie`` or ``death``.
        code
            Status of an ``error``.
        times
            0: every call from then on.
        seconds
            Duration of a ``hang``; None: until `release`.

        Raises
        ------
        ValueError
            No such function, attribute or kind, an ``error`` without its code, or a number that is too small.
        """
        name, _, attribute = function.partition(":")
        if name not in ENTRY_POINTS:
            raise ValueError(f"function is {function!r}; it must be one of the table's entry points")
        if attribute and attribute not in {known.name for known in ATTRIBUTES.values()}:
            raise ValueError(f"attribute is {attribute!r}; it must be one of the table's attributes")
        found = next((known for known in KINDS if known == kind), None)
        if found is None:
            raise ValueError(f"kind is {kind!r}; it must be one of {', '.join(KINDS)}")
        if found == "error" and not code:
            raise ValueError("an error needs its code, for example code=-88710")
        if nth < 1 or times < 0:
            raise ValueError(f"nth is {nth} and times {times}; they must be at least 1 and 0")
        with self._lock:
            self._orders.append(Fault(function, found, code or 0, nth - 1, times, seconds))

    def clear(self) -> None:
        """Discard every requested fault; calls that hang continue to do so until released."""
        with self._lock:
            self._orders.clear()

    def due(self, function: str, attribute: str) -> Fault | None:
        """Count a call for all matching faults and return the oldest that is due; None if none is.

        A fault is removed after its last call.
        """
        with self._lock:
            struck: Fault | None = None
            for order in tuple(self._orders):
                if order.function not in (function, f"{function}:{attribute}"):
                    continue
                if order.skip > 0:
                    order.skip -= 1
                elif struck is None:
                    struck = order
                    if order.times == 1:
                        self._orders.remove(order)
                    elif order.times > 1:
                        order.times -= 1
            return struck

    def hang(self, seconds: float | None) -> None:
        """Block the calling thread until `release`, or for at most ``seconds`` (None: no limit)."""
        with self._released:
            count = self._release_count
            self._hanging += 1
            self._released.notify_all()
            self._released.wait_for(lambda: self._release_count != count, timeout=seconds)
            self._hanging -= 1
            self._released.notify_all()

    def release(self) -> None:
        """Release every call that hangs now; later calls can hang again."""
        with self._released:
            self._release_count += 1
            self._released.notify_all()

    def wait_until_hanging(self, timeout_s: float) -> bool:
        """Block until at least one call hangs; return False if none does within ``timeout_s``."""
        with self._released:
            return self._released.wait_for(lambda: self._hanging > 0, timeout=timeout_s)


def build_wrong_answer(
    entry: EntryPoint, arguments: Mapping[str, Any], answer: Callable[[], Mapping[str, Any]]
) -> dict[str, Any]:
    """Return a plausible wrong answer: success without the effect, or slightly changed values.

    A function without outputs is not executed; others are, by ``answer``, whose errors are raised. A read
    returns half of its samples, a float is 1 % larger, a flag is inverted, another integer is 1 larger, a
    text is empty, an array is doubled, a handle belongs to no task.
    """
    parameters = list_outputs(entry, arguments.get("attribute", 0))
    if not parameters:
        return {}
    values = dict(answer())
    counts = ("samps_per_chan_read", "samps_read")
    for parameter in parameters:
        if parameter.name not in values:
            continue
        if parameter.name in counts:
            values[parameter.name] //= 2
        elif parameter.role is Role.OUT_ARRAY and any(name in values for name in counts):
            values[parameter.name] = values[parameter.name][: len(values[parameter.name]) // 2]
        else:
            values[parameter.name] = _distort_value(parameter, values[parameter.name])
    return values


def _distort_value(parameter: Parameter, value: Any) -> Any:
    """Return a slightly wrong value by the role and type of its parameter (`build_wrong_answer`)."""
    if parameter.role is Role.OUT_TEXT:
        return ""
    if parameter.role is Role.OUT_ARRAY:
        return np.asarray(value) * 2
    if parameter.c_type == "double":
        return value * 1.01
    if parameter.c_type == HANDLE:
        return value + 0x1000
    return 1 - value if value in (0, 1) else value + 1
