"""Statuses of NI-DAQmx that the brain answers with, and their texts.

Negative is an error, positive a warning. The numbers are NI's (`nidaqmx.error_codes`); the texts are
ours, plain ASCII, and close with the task's name and the number as NI's do.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

SAMPLES_WILL_NEVER_BE_AVAILABLE: Final = -200278
SAMPLES_NOT_YET_AVAILABLE: Final = -200284
NOT_DONE_IN_TIME: Final = -200560
STOPPED_BEFORE_DONE: Final = 200010
RESERVED_BY_OTHER_PROCESS: Final = -50103
RESERVED_BY_OTHER_TASK: Final = -200022
INVALID_TASK: Final = -200088
DUPLICATE_TASK: Final = -200089
DEVICE_REMOVED: Final = -88710
DEVICE_ABORTED: Final = -88709
DEVICE_NOT_ACCESSIBLE: Final = -201003
DEVICE_ABSENT: Final = -200324
UNKNOWN_DEVICE: Final = -200220
INVALID_VALUE: Final = -200077
NO_SUCH_PHYSICAL_CHANNEL: Final = -200170
MINIMUM_NOT_BELOW_MAXIMUM: Final = -200082
NO_CHANNELS: Final = -200478
RUNNING: Final = -200479
PROPERTY_WHILE_RUNNING: Final = -200557
NOT_RUNNING: Final = -200475
READ_TYPE_TOO_SMALL: Final = -200789
READ_BUFFER_TOO_SMALL: Final = -200229
NOT_AN_INPUT_TASK: Final = -200460
TOO_MANY_PRETRIGGER_SAMPLES: Final = -200213
INVALID_TRIGGER_SOURCE: Final = -200265
CHANNEL_NOT_IN_TASK: Final = -200486
TERMINAL_IN_USE: Final = -89127
NO_SUCH_ATTRIBUTE: Final = -200233
ATTRIBUTE_NOT_SETTABLE: Final = -200231
ATTRIBUTE_NOT_SUPPORTED: Final = -200197
ATTRIBUTE_NOT_IN_THIS_TASK: Final = -200452
INVALID_SOURCE_TERMINAL: Final = -200040
INVALID_DESTINATION_TERMINAL: Final = -200041
ROUTE_IN_USE: Final = -89137
WATCHDOG_NOT_SUPPORTED: Final = -200662
WATCHDOG_TIMEOUT_OUT_OF_RANGE: Final = -200668
DEVICE_NOT_IN_TASK: Final = -200648
PROPERTY_NEEDS_RESERVED_TASK: Final = -200983
NOT_A_WATCHDOG_TASK: Final = -200635
WATCHDOG_EXPIRED: Final = -201434
EXPIRED_WATCHDOG_NEEDS_CLEARING: Final = -200644
SOFTWARE_FAULT: Final = -50150
TRANSFER_ABORTED: Final = -50405

TEXTS: Mapping[int, str] = MappingProxyType(
    {
        SAMPLES_WILL_NEVER_BE_AVAILABLE: "More samples are asked for than the task will ever acquire.",
        SAMPLES_NOT_YET_AVAILABLE: (
            "Some or all of the samples asked for have not been acquired within the timeout."
        ),
        NOT_DONE_IN_TIME: "The task was not done within the time to wait.",
        STOPPED_BEFORE_DONE: "The task was stopped before its finite acquisition or generation was done.",
        RESERVED_BY_OTHER_PROCESS: "The resource is reserved by another process.",
        RESERVED_BY_OTHER_TASK: "The resource is reserved by another task of this process.",
        INVALID_TASK: "The task is invalid or has been cleared.",
        DUPLICATE_TASK: "A task of this name exists already.",
        DEVICE_REMOVED: "The operation was stopped because the device was removed.",
        DEVICE_ABORTED: "The operation was aborted: the device was reset or removed since the task began.",
        DEVICE_NOT_ACCESSIBLE: "The device cannot be accessed: not plugged in or not powered.",
        DEVICE_ABSENT: "The device is not present or not active in the system.",
        UNKNOWN_DEVICE: "The device identifier is invalid.",
        INVALID_VALUE: "The value asked for is not supported.",
        NO_SUCH_PHYSICAL_CHANNEL: "The physical channel does not exist on this device.",
        MINIMUM_NOT_BELOW_MAXIMUM: "The minimum is not less than the maximum.",
        NO_CHANNELS: "The task has no channels.",
        RUNNING: "Not possible while the task is running.",
        PROPERTY_WHILE_RUNNING: "The property cannot be set while the task is running.",
        NOT_RUNNING: "Not possible while the task is not running.",
        READ_TYPE_TOO_SMALL: "The type to read into is too small for the raw samples; use a wider one.",
        READ_BUFFER_TOO_SMALL: "The buffer has no room for the samples asked for.",
        NOT_AN_INPUT_TASK: "The task has no input channels to read.",
        TOO_MANY_PRETRIGGER_SAMPLES: "Pre-trigger samples and two more do not fit into the record.",
        INVALID_TRIGGER_SOURCE: "The source of the analog trigger is not a channel of the task.",
        CHANNEL_NOT_IN_TASK: "The channel is not in the task.",
        TERMINAL_IN_USE: "The terminal is part of a route and cannot be let go.",
        NO_SUCH_ATTRIBUTE: "The attribute is not known.",
        ATTRIBUTE_NOT_SETTABLE: "The attribute cannot be set.",
        ATTRIBUTE_NOT_SUPPORTED: "The attribute is not supported by this device.",
        ATTRIBUTE_NOT_IN_THIS_TASK: "The attribute has no meaning for this task.",
        INVALID_SOURCE_TERMINAL: "The source terminal of the route does not exist.",
        INVALID_DESTINATION_TERMINAL: "The destination terminal of the route does not exist.",
        ROUTE_IN_USE: "The destination terminal of the route is in use.",
        WATCHDOG_NOT_SUPPORTED: "The device has no watchdog timer.",
        WATCHDOG_TIMEOUT_OUT_OF_RANGE: "The watchdog's timer cannot run so long.",
        DEVICE_NOT_IN_TASK: "The physical channel is of a device that is not in the task.",
        PROPERTY_NEEDS_RESERVED_TASK: "The property has a value only while the task is reserved or running.",
        NOT_A_WATCHDOG_TASK: "The action needs a watchdog task.",
        WATCHDOG_EXPIRED: "The device's watchdog has expired; clear the expiration first.",
        EXPIRED_WATCHDOG_NEEDS_CLEARING: "An expired watchdog cannot be reset; clear the expiration.",
        SOFTWARE_FAULT: "An unexpected software error occurred.",
        TRANSFER_ABORTED: "The transfer was aborted.",
    }
)


class Status(Exception):  # noqa: N818 - a warning is a status too
    """What a call answers when it is not plain success.

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
