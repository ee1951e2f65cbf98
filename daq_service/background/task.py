"""The Protocol of all work between sets."""

from __future__ import annotations

from typing import Protocol

from hardware_drivers.measurement import SetKey


class BackgroundTask(Protocol):
    """Work that the recorder runs in short pieces while no set is due."""

    def run_for(self, seconds: float) -> None:
        """Process one short piece of background work; called repeatedly while no set is due.

        Parameters
        ----------
        seconds
            Time until the next set is due.
        """
        return

    def after_set(self, set_key: SetKey) -> None:
        """Handle a set with records, once its rows are stored."""
        return

    def close(self) -> None:
        """Stop the task; unfinished work is left to the next recorder."""
        return
