"""Statuses of NI-SCOPE that the double answers with, and their texts.

Numbers are those of NI's header ``niScope.h``; the texts are ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from simulator.doubles.vendor_api.statuses import Status

IVI_ERROR = -0x40060000
_messages: dict[int, str] = {}


def _status(code: int, message: str) -> int:
    """Register the text of a status and return its code."""
    _messages[code] = message
    return code


UNKNOWN_RESOURCE = _status(IVI_ERROR + 0x0060, "The resource name is not known; look it up in MAX.")
INVALID_SESSION = _status(IVI_ERROR + 0x1190, "The session handle is not valid.")
ATTRIBUTE_NOT_SUPPORTED = _status(IVI_ERROR + 0x0012, "The attribute is not supported by this board.")
INVALID_VALUE = _status(IVI_ERROR + 0x0010, "The value is not one that the board can take.")
UNKNOWN_CHANNEL = _status(IVI_ERROR + 0x0020, "The channel name is not known.")
MAX_TIME_EXCEEDED = _status(
    IVI_ERROR + 0x2003, "The maximum time was exceeded before the operation completed."
)
CHANNEL_NOT_ENABLED = _status(IVI_ERROR + 0x2001, "The channel is not enabled.")
HARDWARE_FAILURE = _status(IVI_ERROR + 0x4002, "Hardware failure: the board does not answer.")
INSUFFICIENT_MEMORY = _status(IVI_ERROR + 0x4003, "The board's memory does not hold so many samples.")
ACQUISITION_IN_PROGRESS = _status(
    IVI_ERROR + 0x4009, "An acquisition is in progress; only fetch attributes can change now."
)
INITIATE_NOT_CALLED = _status(IVI_ERROR + 0x402A, "No acquisition has been initiated.")
INVALID_FETCH_PARAMETERS = _status(IVI_ERROR + 0x4033, "The fetch parameters are not valid.")
ALREADY_IN_USE = _status(IVI_ERROR + 0x402E, "The digitizer is being used by another application or process.")
ADC_OVERLOAD_WARNING = _status(0x3FFA4008, "One or more channels has an ADC overload.")

MESSAGES: Mapping[int, str] = MappingProxyType(_messages)


class ScopeStatus(Status):
    """Status of NI-SCOPE with its own text."""

    def __init__(self, code: int, detail: str = "", *, values: Mapping[str, Any] | None = None) -> None:
        super().__init__(code, values=values)
        text = MESSAGES[code]
        self.message = f"{text}\n{detail}" if detail else text
        self.args = (self.message,)
