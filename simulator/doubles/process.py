"""The names of `control` under which tests start a double."""

from __future__ import annotations

from simulator.doubles.control import RunningDoubles, running_doubles

__all__ = ["RunningDoubles", "running_doubles"]
