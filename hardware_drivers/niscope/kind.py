"""Ultrasonic probes on NI-SCOPE boards as a kind of instrument."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from hardware_drivers.errors import InstrumentError
from hardware_drivers.instruments import Echo
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, Role, build_error_finding
from hardware_drivers.measurement import ShotKey
from hardware_drivers.niscope.parameters import REACHED_BY, NiscopeParameters

RUNTIME = "see docs/how-to/install-the-ni-driver.md; then power, seating and resource in [rig.niscope.probes]"
SAFE_PART = 0.9
"""An echo beyond this part of the range is about to be clipped when the coupling gets better."""


@contextmanager
def _open_probes(parameters: NiscopeParameters, opening: Opening) -> Iterator[Opened]:
    """Open the boards of all probes and yield them as one pulse-echo unit; they are closed on exit.

    Instrument errors of the opening pass through.
    """
    from hardware_drivers.niscope.pulse_echo import open_niscope

    with open_niscope(parameters) as unit:
        yield Opened(pulse_echo=unit, self_calibrating=unit, identity=unit.identity())


def check_probes(parameters: NiscopeParameters, opening: Opening) -> Iterator[Finding]:
    """Open the board of each probe, take an averaged record, and yield findings on board and record.

    Nothing is fired from here: the record needs the pulser's own triggers, up to ``call_timeout_s``. An
    instrument error becomes a failed finding, and the next probe follows.
    """
    from hardware_drivers.niscope.pulse_echo import open_niscope

    for position, wiring in parameters.probes.items():
        subject, check = f"probe {position}", "board"
        try:
            # One at a time: a board that is missing must not hide the others.
            with open_niscope(replace(parameters, probes={position: wiring})) as unit:
                identity = unit.identity()
                yield Finding(
                    subject=subject,
                    check=check,
                    state="ok",
                    detail=f"{identity[f'probe_{position}']}; NI-SCOPE {identity['ni_scope']}, package "
                    f"{identity['niscope']}",
                    values=dict(identity),
                )
                check = "record"
                key = ShotKey(position=position, set_index=0, shot_index=0)
                yield from _check_record(subject, unit.acquire(key, parameters.call_timeout_s))
        except InstrumentError as error:
            yield build_error_finding(subject, check, error, RUNTIME)


def _check_record(subject: str, echo: Echo) -> Iterator[Finding]:
    """Yield two findings on a record: its amplitude, and the board's last self-calibration (always ok).

    The amplitude is a warning if a sample is clipped or the peak exceeds `SAFE_PART` of the range.
    """
    waveform, settings = echo.waveform, echo.settings
    peak_v = float(np.abs(waveform.volts() - echo.offset_v).max())
    part = peak_v / waveform.calibration.range_v
    clipped = waveform.clipped or settings.get("clipped_records", 0.0) != 0.0
    yield Finding(
        subject=subject,
        check="record",
        state="warn" if clipped or part > SAFE_PART else "ok",
        detail=f"{waveform.counts.size} samples at {waveform.sample_rate_hz / 1e6:g} MS/s, mean of "
        f"{echo.averages}, up to {peak_v:.3g} V ({part:.0%} of the range){', clipped' if clipped else ''}",
        remedy="lower the gain of the pulser-receiver, or take a larger range_v",
        values={"peak_v": peak_v, "sample_rate_hz": waveform.sample_rate_hz, "clipped": clipped},
    )
    yield Finding(
        subject=subject,
        check="self-calibration",
        state="ok",
        detail=f"on {settings['calibration_date']} at {settings['calibration_temperature_c']} C",
        values={key: settings[key] for key in ("calibration_date", "calibration_temperature_c")},
    )


def _check_served_probes(parameters: NiscopeParameters, serves: Mapping[Role, tuple[str, ...]]) -> None:
    """Raise ValueError if a served position has no probe in the parameters, or a probe no served position.

    ``serves`` has the positions of each role; that of the probes is ``pulse_echo``.
    """
    wanted = set(serves.get("pulse_echo", ()))
    if missing := sorted(wanted - set(parameters.probes)):
        raise ValueError(f"probes has no {missing[0]!r}, which it serves; wire it in probes.{missing[0]}")
    if unused := sorted(set(parameters.probes) - wanted):
        raise ValueError(f"probes.{unused[0]} serves no position; take it out, or name it in [rig.positions]")


KIND = Kind(
    parameters=NiscopeParameters,
    open=_open_probes,
    check=check_probes,
    packages=lambda parameters: ("niscope",),
    reached_by=REACHED_BY,
    require=_check_served_probes,
)
