"""Statuses of NI-DAQmx that the double answers with, and their texts.

Negative is an error, positive a warning. The numbers are NI's (`nidaqmx.error_codes`); the texts are
ours, plain ASCII, and close with the task's name and the number as NI's do.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

_texts: dict[int, str] = {}


def _status(code: int, text: str) -> int:
    """Register the text of a status and return its code."""
    _texts[code] = text
    return code


SAMPLES_WILL_NEVER_BE_AVAILABLE = _status(
    -200278, "More samples are asked for than the task will ever acquire."
)
SAMPLES_NOT_YET_AVAILABLE = _status(
    -200284, "Some or all of the samples asked for have not been acquired within the timeout."
)
NOT_DONE_IN_TIME = _status(-200560, "The task was not done within the time to wait.")
STOPPED_BEFORE_DONE = _status(
    200010, "The task was stopped before its finite acquisition or generation was done."
)
RESERVED_BY_OTHER_PROCESS = _status(-50103, "The resource is reserved by another process.")
RESERVED_BY_OTHER_TASK = _status(-200022, "The resource is reserved by another task of this process.")
INVALID_TASK = _status(-200088, "The task is invalid or has been cleared.")
DUPLICATE_TASK = _status(-200089, "A task of this name exists already.")
DEVICE_REMOVED = _status(-88710, "The operation was stopped because the device was removed.")
DEVICE_ABORTED = _status(
    -88709, "The operation was aborted: the device was reset or removed since the task began."
)
DEVICE_NOT_ACCESSIBLE = _status(-201003, "The device cannot be accessed: not plugged in or not powered.")
DEVICE_ABSENT = _status(-200324, "The device is not present or not active in the system.")
UNKNOWN_DEVICE = _status(-200220, "The device identifier is invalid.")
INVALID_VALUE = _status(-200077, "The value asked for is not supported.")
NO_SUCH_PHYSICAL_CHANNEL = _status(-200170, "The physical channel does not exist on this device.")
MINIMUM_NOT_BELOW_MAXIMUM = _status(-200082, "The minimum is not less than the maximum.")
NO_CHANNELS = _status(-200478, "The task has no channels.")
RUNNING = _status(-200479, "Not possible while the task is running.")
PROPERTY_WHILE_RUNNING = _status(-200557, "The property cannot be set while the task is running.")
NOT_RUNNING = _status(-200475, "Not possible while the task is not running.")
READ_TYPE_TOO_SMALL = _status(
    -200789, "The type to read into is too small for the raw samples; use a wider one."
)
READ_BUFFER_TOO_SMALL = _status(-200229, "The buffer has no room for the samples asked for.")
NOT_AN_INPUT_TASK = _status(-200460, "The task has no input channels to read.")
TOO_MANY_PRETRIGGER_SAMPLES = _status(-200213, "Pre-trigger samples and two more do not fit into the record.")
INVALID_TRIGGER_SOURCE = _status(-200265, "The source of the analog trigger is not a channel of the task.")
CHANNEL_NOT_IN_TASK = _status(-200486, "The channel is not in the task.")
TERMINAL_IN_USE = _status(-89127, "The terminal is part of a route and cannot be let go.")
NO_SUCH_ATTRIBUTE = _status(-200233, "The attribute is not known.")
ATTRIBUTE_NOT_SETTABLE = _status(-200231, "The attribute cannot be set.")
ATTRIBUTE_NOT_SUPPORTED = _status(-200197, "The attribute is not supported by this device.")
ATTRIBUTE_NOT_IN_THIS_TASK = _status(-200452, "The attribute has no meaning for this task.")
INVALID_SOURCE_TERMINAL = _status(-200040, "The source terminal of the route does not exist.")
INVALID_DESTINATION_TERMINAL = _status(-200041, "The destination terminal of the route does not exist.")
ROUTE_NOT_SUPPORTED = _status(-89136, "The hardware has no such route.")
NO_TRIGGER_LINE = _status(-89125, "No trigger line is registered between the two devices of the route.")
START_DELAY_TOO_LONG = _status(-200334, "The delay from the start trigger is too long for the device.")
START_DELAY_TOO_SHORT = _status(-200333, "The delay from the start trigger is too short for the device.")
ROUTE_IN_USE = _status(-89137, "The destination terminal of the route is in use.")
WATCHDOG_NOT_SUPPORTED = _status(-200662, "The device has no watchdog timer.")
WATCHDOG_TIMEOUT_OUT_OF_RANGE = _status(-200668, "The watchdog's timer cannot run so long.")
DEVICE_NOT_IN_TASK = _status(-200648, "The physical channel is of a device that is not in the task.")
PROPERTY_NEEDS_RESERVED_TASK = _status(
    -200983, "The property has a value only while the task is reserved or running."
)
NOT_A_WATCHDOG_TASK = _status(-200635, "The action needs a watchdog task.")
WATCHDOG_EXPIRED = _status(-201434, "The device's watchdog has expired; clear the expiration first.")
EXPIRED_WATCHDOG_NEEDS_CLEARING = _status(
    -200644, "An expired watchdog cannot be reset; clear the expiration."
)
SOFTWARE_FAULT = _status(-50150, "An unexpected software error occurred.")
TRANSFER_ABORTED = _status(-50405, "The transfer was aborted.")

TEXTS: Mapping[int, str] = MappingProxyType(_texts)


class Status(Exception):  # noqa: N818 - a warning is a status too
    """Status of a call that is not plain success.

    Parameters
    ----------
    code
        Negative for an error, positive for a warning.
    detail
        What exactly, behind the code's own text.
    task
        Name of the task concerned.
    values
        Out parameters that are answered all the same: all of them with a warning.
    """

    def __init__(
        self, code: int, detail: str = "", *, task: str = "", values: Mapping[str, Any] | None = None
    ) -> None:
        parts = [TEXTS.get(code, "The double was told to answer with this status.")]
        parts += [detail] if detail else []
        parts += [f"Task Name: {task}"] if task else []
        parts.append(f"Status Code: {code}")
        self.code = code
        self.message = "\n".join(parts)
        self.values = dict(values or {})
        super().__init__(self.message)


def rejected_property(
    task: str, name: str, detail: str = "", *, code: int = INVALID_VALUE, **values: object
) -> Status:
    """Return the status for a rejected property.

    ``requested``, ``minimum`` and ``maximum``, in NI's words.
    """
    value_lines = [f"{label.title()} Value: {value}" for label, value in values.items()]
    return Status(code, "\n".join([f"Property: {name}", *value_lines, *filter(None, [detail])]), task=task)
