"""Boards by serial number: their present names, and whether they can take the requested record."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hardware_drivers.daqmx.connection import Connection
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.daqmx.translation import read_metadata, translate_errors
from hardware_drivers.errors import ConfigurationError, ConnectionLostError

if TYPE_CHECKING:
    from nidaqmx.system import Device

log = logging.getLogger(__name__)

RELATIVE_AGREEMENT = 1e-6
"""Two rates or ranges closer than this are the same: far below a board's own accuracy (50 ppm)."""


ABSENT = frozenset({-201003, -200324, -200220, -200045, -89130})
"""What the driver says of a board that is listed but not there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Board:
    """Board under its present name.

    Attributes
    ----------
    device
        NI's view of it (`nidaqmx.system.Device`).
    calibration_date, calibration_temperature_c
        Of the last self-calibration; empty and NaN where the driver does not say.
    simulated
        NI's driver makes its records up.
    """

    serial: str
    name: str
    product: str
    device: Device
    calibrates_itself: bool
    calibration_date: str
    calibration_temperature_c: float
    simulated: bool

    @property
    def label(self) -> str:
        """Return product and serial number, which name the board in messages."""
        return f"{self.product} {self.serial}"


def format_serial(serial: int) -> str:
    """Format a serial number as NI prints it on the label: 8 hexadecimal digits, upper case."""
    return f"{serial:08X}"


def normalize_serial(text: str) -> str:
    """Convert a hexadecimal serial number, any case, to 8 upper-case digits; ValueError if it is none."""
    return format_serial(int(text, 16))


def list_boards(connection: Connection) -> dict[str, Device]:
    """List the boards that the driver knows and that answer: NI's device by serial number.

    NI's simulated devices all have serial number 0: only the last one is kept. A board that is listed but
    absent is left out, with a log entry; other instrument errors are raised.
    """
    system = connection.system()
    with translate_errors("listing the boards"):
        devices = list(system.devices)
    found = {}
    for device in devices:
        try:
            with translate_errors(f"reading the serial number of {device.name}"):
                found[format_serial(device.serial_num)] = device
        except ConnectionLostError as error:
            if getattr(error.__cause__, "error_code", 0) not in ABSENT:
                raise
            # NI MAX remembers boards that are gone; someone else's must not stop us.
            log.info("%s is listed but not there", device.name)
    return found


def find_boards(connection: Connection, serials: Iterable[str]) -> dict[str, Board]:
    """Find the boards with these serial numbers, and describe each under its present name.

    Returns
    -------
    dict
        Boards by serial number (8 hexadecimal digits), in ascending order; each once.

    Raises
    ------
    ConnectionLostError
        One of them is not there: switched off, pulled, or its number mistyped.
    """
    known = list_boards(connection)
    found = {}
    for serial in sorted({normalize_serial(text) for text in serials}):
        if serial not in known:
            there = ", ".join(f"{one} ({device.name})" for one, device in known.items()) or "none"
            raise ConnectionLostError(
                f"no board with serial number {serial}; there are: {there}; "
                "check its power, seating and cable, and board_serial in [rig.daqmx.transducers]"
            )
        found[serial] = describe_board(serial, known[serial])
    return found


def describe_board(serial: str, device: Device) -> Board:
    """Read a board's name, product, self-calibration, and whether NI's driver simulates it.

    Optional metadata that is unknown is logged: empty date, NaN temperature (degrees Celsius), False. Raise
    ConnectionLostError if the board is gone, or has no name or product.
    """
    with translate_errors(f"reading what board {serial} is"):
        name, product = str(device.name), str(device.product_type)
        if not (name and product):
            raise ConnectionLostError(f"board {serial} gives its name as {name!r} and product as {product!r}")
    calibrates_itself = read_metadata(
        lambda: bool(device.self_cal_supported), False, f"whether board {serial} calibrates itself"
    )
    date, temperature_c = "", math.nan
    if calibrates_itself:
        date = read_metadata(
            lambda: str(device.self_cal_last_date_and_time.isoformat(timespec="minutes")),
            "",
            f"when board {serial} was calibrated",
        )
        temperature_c = read_metadata(
            lambda: float(device.self_cal_last_temp), math.nan, f"how warm board {serial} was then"
        )
    return Board(
        serial=serial,
        name=name,
        product=product,
        device=device,
        calibrates_itself=calibrates_itself,
        calibration_date=date,
        calibration_temperature_c=temperature_c,
        simulated=read_metadata(
            lambda: bool(device.is_simulated), False, f"whether board {serial} is simulated"
        ),
    )


def check_board(board: Board, wiring: TransducerWiring, parameters: DaqmxParameters) -> None:
    """Raise an error unless a board can take the requested record: rate, range, analog trigger.

    Raises
    ------
    ConfigurationError
        Too slow, no such range, or no analog trigger (which a dry run does not need).
    ConnectionLostError
        The board does not answer.
    """
    with translate_errors(f"reading what {board.label} can do"):
        limit_hz = float(board.device.ai_max_single_chan_rate)
        ends_v = [float(value) for value in board.device.ai_voltage_rngs]
        triggers = bool(board.device.anlg_trig_supported)
    if parameters.sample_rate_hz > limit_hz * (1.0 + RELATIVE_AGREEMENT):
        raise ConfigurationError(
            f"sample_rate_hz is {parameters.sample_rate_hz:.10g} Hz; {board.label} does at most "
            f"{limit_hz:.10g} Hz on one channel; lower the rate to that or use a faster board"
        )
    ranges = list(zip(ends_v[::2], ends_v[1::2], strict=False))
    if not any(
        is_requested_value(high, wiring.range_v) and is_requested_value(-low, wiring.range_v)
        for low, high in ranges
    ):
        have = ", ".join(f"{low:g}..{high:g}" for low, high in ranges)
        raise ConfigurationError(
            f"range_v is {wiring.range_v} V; {board.label} has the ranges {have} V; choose one of them"
        )
    if not triggers and not parameters.dry_run:
        raise ConfigurationError(
            f"{board.label} has no analog trigger, which starts every record; use a board that has one"
        )


def is_requested_value(given: float, requested: float) -> bool:
    """Return whether the value ``given`` by the driver is the requested one, within 1e-6 of the larger."""
    return math.isclose(given, requested, rel_tol=RELATIVE_AGREEMENT)
