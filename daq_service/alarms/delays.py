"""On-delay, off-delay and deadband of alarms (ISA-18.2). Pure."""

from __future__ import annotations

from dataclasses import replace

from daq_service.alarms.states import Condition, Moment
from daq_service.catalogue.rows import AlarmRow
from daq_service.settings.alarm_delays import AlarmKindSettings
from hardware_drivers.nanoseconds import NS_PER_S

DELAY_EVENT = "alarm_delay"
"""Event that contains the start of an alarm's delay, or its end."""


def apply_delays(
    row: AlarmRow | None, condition: Condition, since_ns: int | None, moment: Moment, rule: AlarmKindSettings
) -> tuple[Condition | None, int | None]:
    """Apply on-delay, off-delay and deadband (ISA-18.2) to the condition of an alarm.

    With a deadband, the condition of an active alarm also counts as present while its ``times_limit``
    (quantity divided by limit) is None or above 1 - `dead_band_fraction`.

    Parameters
    ----------
    row
        The latest alarm of this position and kind, or None.
    since_ns
        Start of the running delay, ns of UTC on the experiment's clock; None if none runs.
    rule
        Delays and deadband of its kind (`alarms.kinds`).

    Returns
    -------
    Condition or None
        Condition to apply, present also within the deadband; None while a delay runs: the alarm stays as it
        is.
    int or None
        New value of ``since_ns``; None if no delay runs.
    """
    is_active = row is not None and row.state in ("unacknowledged", "acknowledged")
    # An unknown quantity has not returned to normal.
    is_below_deadband = (
        condition.times_limit is not None and condition.times_limit <= 1.0 - rule.dead_band_fraction
    )
    if is_active and rule.dead_band_fraction and not is_below_deadband:
        condition = replace(condition, present=True)
    delay_s = rule.on_delay_s if condition.present else rule.off_delay_s
    if condition.present == is_active or not delay_s:
        return condition, None
    since_ns = moment.utc_ns if since_ns is None else since_ns
    is_over = moment.utc_ns - since_ns >= delay_s * NS_PER_S
    return (condition, None) if is_over else (None, since_ns)
