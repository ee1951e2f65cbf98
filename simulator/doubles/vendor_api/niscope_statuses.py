"""Statuses of NI-SCOPE that the double answers with, and their texts.

Numbers are those of NI's header ``niScope.h``; the texts are ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from simulator.doubles.vendor_api.statuses import Status

IVI_ERROR: Final = -0x40060000
UNKNOWN_RESOURCE: Final = IVI_ERROR + 0x0060
INVALID_SESSION: Final = IVI_ERROR + 0x1190
ATTRIBUTE_NOT_SUPPORTED: Final = IVI_ERROR + 0x0012
INVALID_VALUE: Final = IVI_ERROR + 0x0010
UNKNOWN_CHANNEL: Final = IVI_ERROR + 0x0020
MAX_TIME_EXCEEDED: Final = IVI_ERROR + 0x2003
CHANNEL_NOT_ENABLED: Final = IVI_ERROR + 0x2001
HARDWARE_FAILURE: Final = IVI_ERROR + 0x4002
INSUFFICIENT_MEMORY: Final = IVI_ERROR + 0x4003
ACQUISITION_IN_PROGRESS: Final = IVI_ERROR + 0x4009
INITIATE_NOT_CALLED: Final = IVI_ERROR + 0x402A
INVALID_FETCH_PARAMETERS: Final = IVI_ERROR + 0x4033
ALREADY_IN_USE: Final = IVI_ERROR + 0x402E
ADC_OVERLOAD_WARNING: Final = 0x3FFA4008

MESSAGES: Mapping[int, str] = MappingProxyType(
    {
        UNKNOWN_RESOURCE: "The resource name is not known; look it up in MAX.",
        INVALID_SESSION: "The session handle is not valid.",
        ATTRIBUTE_NOT_SUPPORTED: "The attribute is not supported by this board.",
        INVALID_VALUE: "The value is not one that the board can take.",
        UNKNOWN_CHANNEL: "The channel name is not known.",
        MAX_TIME_EXCEEDED: "The maximum time was exceeded before the operation completed.",
        CHANNEL_NOT_ENABLED: "The channel is not enabled.",
        HARDWARE_FAILURE: "Hardware failure: the board does not answer.",
        INSUFFICIENT_MEMORY: "The board's memory does not hold so many samples.",
        ACQUISITION_IN_PROGRESS: "An acquisition is in progress; only fetch attributes can change now.",
        INITIATE_NOT_CALLED: "No acquisition has been initiated.",
        INVALID_FETCH_PARAMETERS: "The fetch parameters are not valid.",
        ALREADY_IN_USE: "The digitizer is being used by another application or process.",
        ADC_OVERLOAD_WARNING: "One or more channels has an ADC overload.",
    }
)


class ScopeStatus(Status):
    """Status of NI-SCOPE with its own text."""

    def __init__(self, code: int, detail: str = "", *, values: Mapping[str, Any] | None = None) -> None:
        super().__init__(code, values=values)
        text = MESSAGES[code]
        self.message = f"{text}\n{detail}" if detail else text
        self.args = (self.message,)
