"""NI-DAQmx boards as a kind of instrument: digitizer, striker or both, over one connection."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager

from hardware_drivers.daqmx.parameters import REACHED_BY, DaqmxParameters
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, Role


def _open_boards(parameters: DaqmxParameters, opening: Opening) -> AbstractContextManager[Opened]:
    """Return the context manager that opens the boards (`open_daqmx`); nothing is opened yet."""
    from hardware_drivers.daqmx.instruments import open_daqmx

    return open_daqmx(parameters)


def _check_boards(parameters: DaqmxParameters, opening: Opening) -> Iterator[Finding]:
    """Return the iterator over the findings on driver, boards and wiring; nothing strikes."""
    from hardware_drivers.daqmx.look import yield_board_findings

    return yield_board_findings(parameters, shot_interval_s=opening.shot_interval_s)


def _list_packages(parameters: DaqmxParameters) -> tuple[str, ...]:
    """Return the distributions that the transport needs: nidaqmx, with grpcio for ``grpc``."""
    return ("nidaqmx", "grpcio") if parameters.transport == "grpc" else ("nidaqmx",)


def _check_wired_positions(parameters: DaqmxParameters, serves: Mapping[Role, tuple[str, ...]]) -> None:
    """Raise ValueError for a wired input or counter that serves no position, or a served one not wired.

    ``serves`` has the positions of each role; an input serves ``digitizer``, a counter ``striker``.
    """
    ends: tuple[tuple[Role, str], ...] = (("digitizer", "input"), ("striker", "counter"))
    for position, wiring in parameters.transducers.items():
        for role, end in ends:
            if getattr(wiring, end) and position not in serves.get(role, ()):
                raise ValueError(
                    f"transducers.{position}.{end} is {getattr(wiring, end)!r}, but these boards are not the "
                    f"{role} of {position!r}; set {end} = '', or name them in [rig.positions.{position}]"
                )
    for role, end in ends:
        for position in serves.get(role, ()):
            if position not in parameters.transducers or not getattr(parameters.transducers[position], end):
                raise ValueError(
                    f"transducers.{position}.{end} is missing; these boards are the {role} of {position!r}: "
                    f"wire it, or name another instrument in [rig.positions.{position}]"
                )


KIND = Kind(
    parameters=DaqmxParameters,
    open=_open_boards,
    check=_check_boards,
    packages=_list_packages,
    # A call of NI's own library has no bound of its own.
    longest_call_s=lambda parameters: parameters.longest_call_s if parameters.transport == "grpc" else 0.0,
    reached_by=REACHED_BY,
    require=_check_wired_positions,
)
