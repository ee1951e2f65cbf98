"""Boards in the chassis: presence, names and calibration."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from datetime import datetime

from hardware_drivers.measurement import Calibration
from simulator.doubles.chassis.boards import BoardType, get_board_calibration
from simulator.doubles.chassis.description import BoardParameters
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status
from simulator.parameters.electronics import AdcParameters

_LINES = re.compile(
    r"^/?(?P<device>[^/]+)/(?P<port>port\d+)/line(?P<first>\d+)(:(?P<last>\d+))?$", re.IGNORECASE
)


class Device:
    """Board: its type is fixed, its place, name and calibration change."""

    def __init__(self, parameters: BoardParameters) -> None:
        self.parameters = parameters
        self.name = parameters.name
        self.plugged = True
        self.calibrated = datetime.fromisoformat(parameters.calibrated)
        self.calibration_temperature_c = self.temperature_c
        self.offset_shift_v = 0.0
        self.power_up_states: dict[str, int] = {}

    @property
    def serial_number(self) -> int:
        """Return the serial number that identifies the board."""
        return self.parameters.serial_number

    @property
    def kind(self) -> BoardType:
        """Return the board type of the product, with the figures of its data sheet."""
        return self.parameters.kind

    @property
    def temperature_c(self) -> float:
        """Return the temperature of the board's own sensor, °C; a simulated board has none and returns 0."""
        return 0.0 if self.parameters.simulated else self.parameters.temperature_c

    def calibration(self, range_v: float) -> Calibration:
        """Return the board's present polynomial from codes to V in an input range, -range_v to +range_v."""
        adc = self.parameters.adc(AdcParameters(range_v=range_v, trigger_level_v=0.5 * range_v))
        return get_board_calibration(adc, self.offset_shift_v)

    def self_calibrate(self, now: datetime) -> None:
        """Set time and temperature of the last self-calibration; shift the offset by the described step."""
        self.calibrated = now
        self.calibration_temperature_c = self.temperature_c
        self.offset_shift_v += self.parameters.self_calibration_shift_v


class Devices:
    """Boards by name as in NI MAX; case does not matter."""

    def __init__(self, boards: Iterable[BoardParameters]) -> None:
        self._devices = {board.serial_number: Device(board) for board in boards}
        self._former_names: set[str] = set()

    def __iter__(self) -> Iterator[Device]:
        return iter(self._devices.values())

    def present(self) -> tuple[Device, ...]:
        """Return the boards that are plugged in, in the order of the description."""
        return tuple(device for device in self if device.plugged)

    def get_by_serial(self, serial_number: int) -> Device:
        """Return a board by serial number, plugged in or not; raise KeyError if there is none."""
        return self._devices[serial_number]

    def find(self, name: str) -> Device:
        """Return the plugged-in board of a name; case and slashes around the name do not matter.

        Raises
        ------
        Status
            The board is not plugged in or was renamed (-201003), or is unknown (-200220).
        """
        wanted = name.strip().strip("/").casefold()
        for device in self:
            if device.name.casefold() == wanted and device.plugged:
                return device
        known = {device.name.casefold() for device in self} | self._former_names
        code = statuses.DEVICE_NOT_ACCESSIBLE if wanted in known else statuses.UNKNOWN_DEVICE
        raise Status(code, f"Device Specified: {name}")

    def unplug(self, serial_number: int) -> None:
        """Mark a board as removed; its name stays in NI MAX. Raise KeyError if there is none."""
        self.get_by_serial(serial_number).plugged = False

    def plug(self, serial_number: int, name: str = "") -> None:
        """Plug a board in again, under another name if one is given; raise KeyError if there is none.

        A former name is then known, but not accessible.
        """
        device = self.get_by_serial(serial_number)
        self._former_names.add(device.name.casefold())
        device.name = name or device.name
        device.plugged = True

    def channel(self, text: str, part: str) -> tuple[Device, int]:
        """Parse a physical channel like ``Dev1/ai0`` (``part``: ``ai`` or ``ctr``) into board and number.

        Raises
        ------
        Status
            -200170 for a text that is not a single channel of its board, and as `find`.
        """
        name, _, end = text.strip().strip("/").partition("/")
        device = self.find(name)
        limit = device.kind.analog_inputs if part == "ai" else len(device.kind.counter_terminals)
        number = end.casefold().removeprefix(part)
        if not end.casefold().startswith(part) or not number.isdecimal() or int(number) >= limit:
            raise Status(
                statuses.NO_SUCH_PHYSICAL_CHANNEL,
                f"Physical Channel: {text}; {device.name} ({device.kind.product}) has {part}0 to "
                f"{part}{limit - 1}, and a task of the double takes one.",
            )
        return device, int(number)

    def lines(self, text: str) -> list[tuple[Device, str]]:
        """Parse names of lines like ``Dev1/port2/line4:6, Dev1/port1/line0`` into boards and lines, in order.

        Raises
        ------
        Status
            -200170 for a text that is no line of its board, a whole port included, and as `find`.
        """
        found: list[tuple[Device, str]] = []
        for piece in text.split(","):
            match = _LINES.match(piece.strip())
            device = self.find(piece.strip().strip("/").partition("/")[0])
            named: list[str] = []
            if match is not None:
                numbers = _build_inclusive_range(int(match["first"]), int(match["last"] or match["first"]))
                named = [f"{match['port'].casefold()}/line{number}" for number in numbers]
            if not named or not set(named) <= set(device.kind.digital_lines):
                lines = device.kind.digital_lines
                raise Status(
                    statuses.NO_SUCH_PHYSICAL_CHANNEL,
                    f"Physical Channel: {piece.strip()}; {device.name} ({device.kind.product}) has "
                    f"{lines[0]} to {lines[-1]}.",
                )
            found += [(device, line) for line in named]
        return found


def _build_inclusive_range(first: int, last: int) -> range:
    """Return the numbers from first to last, rising or falling, both included."""
    step = 1 if last >= first else -1
    return range(first, last + step, step)
