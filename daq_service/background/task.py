"""The Protocol of all work between sets."""

from __future__ import annotations

from typing import Protocol

from hardware_drivers.measurement import SetKey


class BackgroundTask(Protocol):
    """Work that the recorder runs in short pieces while no set is due."""

    def run_for(self, seconds: float) -> None:
        """Do a piece of work.

        Parameters
        ----------
        seconds
            Time until the next set is due.
        """
        return

    def after_set(self, set_key: SetKey) -> None:
        """Note that the rows of a set with records are stored."""
        return

    def close(self) -> None:
        """End; the next recorder does the rest."""
        return
