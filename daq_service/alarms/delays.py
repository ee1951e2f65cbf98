"""On-delay, off-delay and dead-band (ISA-18.2): what holds an alarm back from its condition. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from daq_service.alarms.states import Condition, Moment
from daq_service.catalogue.rows import AlarmRow
from daq_service.settings.alarm_delays import AlarmKindSettings
from hardware_drivers.nanoseconds import NS_PER_S

DELAY_EVENT = "alarm_delay"
"""Event that tells since when an alarm is held back by its delay, or that it is so no more."""
AT_ONCE = AlarmKindSettings()


def followed(
    row: AlarmRow | None,
    condition: Condition,
    since_ns: int | None,
    moment: Moment,
    kinds: Mapping[str, AlarmKindSettings],
) -> tuple[Condition | None, int | None]:
    """Tell what an alarm follows now, and since when its delay holds it back.

    Parameters
    ----------
    row
        The latest alarm of this position and kind, or None.
    since_ns
        Since when it has been held back, ns of UTC on the experiment's clock; None: it is not.
    kinds
        Delays and dead-bands by kind (`alarms.kinds`); a kind that is absent has none.

    Returns
    -------
    Condition or None
        None: the alarm stays as it is.
    int or None
        ``since_ns`` from now on.
    """
    rule = kinds.get(condition.kind, AT_ONCE)
    stands = row is not None and row.state in ("unacknowledged", "acknowledged")
    # A quantity that nobody knows now is not back.
    is_back = condition.times_limit is not None and condition.times_limit <= 1.0 - rule.dead_band_fraction
    if stands and rule.dead_band_fraction and not is_back:
        condition = replace(condition, present=True)
    delay_s = rule.on_delay_s if condition.present else rule.off_delay_s
    if condition.present == stands or not delay_s:
        return condition, None
    since_ns = moment.utc_ns if since_ns is None else since_ns
    is_over = moment.utc_ns - since_ns >= delay_s * NS_PER_S
    return (condition, None) if is_over else (None, since_ns)
