"""Base of instruments with a text protocol: the line, the reported name, deadlines."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from hardware_drivers.instruments import require_timeout
from hardware_drivers.measurement import Stamp
from hardware_drivers.serial_port.dialects import NAME_BY_COMMAS
from hardware_drivers.serial_port.line import SerialLine
from hardware_drivers.serial_port.parameters import ClimateParameters, SupplyParameters

Parameters = TypeVar("Parameters", bound=SupplyParameters | ClimateParameters)


class SerialInstrument(Generic[Parameters]):
    """Instrument that reports its name and responds to queries.

    Parameters
    ----------
    parameters
        Line, name, what to ask. Nothing is opened before the first call.
    stamp
        The caller's clock: dates the readings, and its monotonic time spaces attempts to reconnect.
    monotonic_s
        The machine's monotonic time, for deadlines.
    """

    def __init__(
        self,
        parameters: Parameters,
        *,
        stamp: Callable[[], Stamp],
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Build the line to the instrument; nothing is opened or sent here."""
        self._parameters = parameters
        self._stamp = stamp
        self._line = SerialLine(
            parameters.line,
            identity=parameters.identity,
            identity_query=parameters.identity_query,
            stamp=stamp,
            monotonic_s=monotonic_s,
        )

    def identity(self) -> Mapping[str, str]:
        """Return the instrument's maker, model, serial number, firmware and port by name of the item.

        ``maker``, ``model``, ``serial_number`` and ``firmware`` are empty where its response has none. The
        query of its name is sent only if the line is not in step.

        Raises
        ------
        BusyError, ConfigurationError, ConnectionLostError
            As for `read`.
        """
        self._connect(self._deadline_s(self._parameters.read_timeout_s))
        found = re.fullmatch(self._name_pattern, self._line.name)
        parts = {} if found is None else found.groupdict(default="")
        names = ("maker", "model", "serial_number", "firmware")
        return {
            **{name: parts.get(name, "").strip() for name in names},
            "port": self._line.parameters.port,
        }

    @property
    def _name_pattern(self) -> str:
        """Return the pattern of the response to the identity query, with named groups."""
        return NAME_BY_COMMAS

    def close(self) -> None:
        """Close the port; repeated calls have no effect. A later call opens it again."""
        self._line.close()

    def _connect(self, deadline_s: float, *, at_once: bool = False) -> None:
        """Open the line and verify the instrument's name, unless the line is in step already.

        ``at_once`` ignores the wait after a failed attempt. Raise as `SerialLine.connect` does.
        """
        self._line.connect(deadline_s, at_once=at_once)

    def _deadline_s(self, timeout_s: float) -> float:
        """Return the machine's monotonic time (s) at which a call that starts now must have ended.

        Raise ConfigurationError for a timeout that is not positive.
        """
        require_timeout(timeout_s)
        return self._line.monotonic_s() + timeout_s
