"""Charge through the corrosion cell from measured current, and its state over a restart.

Current is integrated by the trapezoid rule over pairs of readings. Time between two readings more than three
intervals apart is booked as unknown, since the current was not measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from daq_service.catalogue.rows import EnvironmentRow
from daq_service.corrosion_drive.reading_log import LONGEST_GAP_INTERVALS
from hardware_drivers.drive_parameters import DriveParameters
from hardware_drivers.measurement import Stamp
from hardware_drivers.nanoseconds import NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Charge:
    """Charge since hour 0, and time without a measured current, s."""

    coulomb: float = 0.0
    unknown_s: float = 0.0


def integrate_charge(
    charge: Charge, *, elapsed_s: float, first_a: float, last_a: float, longest_s: float
) -> Charge:
    """Integrate the current between two readings by the trapezoid rule, Q += (I_1 + I_2) t / 2.

    Return the new charge; ``charge`` is not changed.

    Parameters
    ----------
    elapsed_s
        Time between them, s; a negative one (the clock was set back) counts as 0.
    first_a, last_a
        Measured currents in A with sign: the scatter of an ammeter about zero averages out.
    longest_s
        A longer interval, s, is added to the time with unknown current instead.
    """
    elapsed_s = max(elapsed_s, 0.0)
    if elapsed_s > longest_s:
        return replace(charge, unknown_s=charge.unknown_s + elapsed_s)
    return replace(charge, coulomb=charge.coulomb + 0.5 * (first_a + last_a) * elapsed_s)


def compute_elapsed_s(before: Stamp, after: Stamp) -> float:
    """Compute the time in s from the stamp ``before`` to ``after``: monotonic in one boot, else by UTC.

    Negative if ``after`` is earlier, as when the clock was set back between boots.
    """
    if before.boot_id == after.boot_id:
        return (after.mono_ns - before.mono_ns) / NS_PER_S
    return (after.utc_ns - before.utc_ns) / NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """Command `on` in force: voltage and current limit that were set; None: as configured."""

    voltage_v: float | None = None
    current_limit_a: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveState:
    """State that a restart restores.

    Attributes
    ----------
    command
        The command `on` in force; None: the output must be off.
    must_switch_off
        The output has not been read as off since it had to be switched off.
    tripped
        Reason why the interlock has tripped; None: it has not.
    latched
        Alarm kinds that last until the next command.
    booked_utc_ns
        End of the booked charge and unknown time; None: nothing was measured yet.
    """

    charge: Charge = Charge()
    command: Command | None = None
    must_switch_off: bool = False
    tripped: str | None = None
    latched: frozenset[str] = frozenset()
    booked_utc_ns: int | None = None


def restore_drive_state(
    row: EnvironmentRow | None, *, written_utc_ns: int, parameters: DriveParameters
) -> DriveState:
    """Restore the supply's state from the newest row of ``environment``, written at ``written_utc_ns``.

    Without a row, or with one of a test without supply, return the default state. A command `on` is restored,
    with configured values, only if the output was on and the interlock had not tripped.
    """
    if row is None or row.supply_state == "absent":
        return DriveState()
    charge = Charge(coulomb=row.charge_coulomb or 0.0, unknown_s=row.unknown_s or 0.0)
    age_s = row.supply_age_s
    booked_utc_ns = None
    if age_s is not None:
        # A gap that was already too long is in the row's unknown time up to its writing.
        open_s = age_s if age_s <= LONGEST_GAP_INTERVALS * parameters.log_interval_s else 0.0
        booked_utc_ns = written_utc_ns - round(open_s * NS_PER_S)
    return DriveState(
        charge=charge,
        tripped=row.supply_tripped,
        command=Command() if row.supply_state == "on" and row.supply_tripped is None else None,
        booked_utc_ns=booked_utc_ns,
    )
