"""The Protocol of all work between sets."""

from __future__ import annotations

from typing import Protocol

from hardware_drivers.measurement import SetKey


class BackgroundTask(Protocol):
    """Work that the recorder runs in short pieces while no set is due."""

    def run_for(self, seconds: float) -> None:
        """Process one short piece of background work; the recorder calls it repeatedly while no set is due.

        Parameters
        ----------
        seconds
            Time until the next set is due.
        """
        return

    def after_set(self, set_key: SetKey) -> None:
        """React to a set that has records; called once its rows are stored."""
        return

    def close(self) -> None:
        """Stop the task, once at the end of the recorder; unfinished work is left to the next recorder."""
        return
