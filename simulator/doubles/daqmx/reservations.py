"""Reservations of parts of the boards."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status


@dataclass(frozen=True, slots=True, kw_only=True)
class Holder:
    """Holder of a reservation: a task of a client, or an outside program (`occupy`)."""

    client: str
    task: str


class Reservations:
    """Resources ``<serial number>/<part>`` (``ai``, ``ctr0``, ``watchdog``) and their holders."""

    def __init__(self) -> None:
        self._held: dict[str, Holder] = {}

    @property
    def held(self) -> dict[str, Holder]:
        """Return a copy of all reservations: resource name to holder."""
        return dict(self._held)

    def take(self, resources: Iterable[str], holder: Holder) -> None:
        """Reserve all of the resources or none; those that the holder has already stay with it.

        Raises
        ------
        Status
            Another holder has one of them: -50103 if it is another process, else -200022.
        """
        wanted = tuple(resources)
        for resource in wanted:
            other = self._held.get(resource, holder)
            if other != holder:
                code = (
                    statuses.RESERVED_BY_OTHER_TASK
                    if other.client == holder.client
                    else statuses.RESERVED_BY_OTHER_PROCESS
                )
                raise Status(
                    code, f"{resource} is reserved by task {other.task} of {other.client}.", task=holder.task
                )
        self._held.update(dict.fromkeys(wanted, holder))

    def occupy(self, resource: str, owner: str) -> None:
        """Reserve a resource for a program ``owner`` in another process, replacing the present holder."""
        self._held[resource] = Holder(client="another process", task=owner)

    def release(self, holder: Holder) -> None:
        """Release all resources of one holder; do nothing if it has none."""
        self._held = {resource: other for resource, other in self._held.items() if other != holder}

    def release_board(self, serial_number: int) -> None:
        """Release all resources of one board, of every holder."""
        held = self._held.items()
        self._held = {name: holder for name, holder in held if parse_serial(name) != serial_number}

    def holders_of_board(self, serial_number: int) -> tuple[Holder, ...]:
        """Return the holder of each reserved resource of one board; one holder may occur more than once."""
        return tuple(holder for name, holder in self._held.items() if parse_serial(name) == serial_number)


def format_resource(serial_number: int, part: str) -> str:
    """Format the name of one part of a board, ``<serial number>/<part>``."""
    return f"{serial_number}/{part}"


def parse_serial(name: str) -> int:
    """Parse the board's serial number from the name of a resource or line, ``<serial number>/<part>``.

    Raises
    ------
    ValueError
        The name does not start with a number.
    """
    return int(name.partition("/")[0])
