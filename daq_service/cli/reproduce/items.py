"""List of all figures and tables in the paper's order; the slips come last."""

from __future__ import annotations

from daq_service.cli.reproduce.detection_figures import FIG14, FIG15
from daq_service.cli.reproduce.equations import EQUATIONS
from daq_service.cli.reproduce.item import Item
from daq_service.cli.reproduce.model_figures import FIG10, FIG12, FIG13
from daq_service.cli.reproduce.setup_figures import FIG5, FIG6
from daq_service.cli.reproduce.slips import SLIP_LIST
from daq_service.cli.reproduce.tables import TABLE1, TABLE2
from daq_service.cli.reproduce.trend_figures import FIG8, FIG9, FIG11
from daq_service.cli.reproduce.waveforms import FIG7
from daq_service.errors import UsageError

ITEMS = (
    TABLE1, FIG5, FIG6, FIG7, FIG8, FIG9, FIG10, FIG11, FIG12, TABLE2, FIG13, FIG14, FIG15, EQUATIONS,
    SLIP_LIST,
)  # fmt: skip


def choose_items(only: str | None) -> tuple[Item, ...]:
    """Parse item names separated by commas and return the items in the paper's order; None means all.

    Raises
    ------
    UsageError
        A name that does not exist, or none at all.
    """
    if only is None:
        return ITEMS
    names = [name.strip() for name in only.split(",") if name.strip()]
    known = {item.name for item in ITEMS}
    unknown = sorted(set(names) - known)
    if unknown or not names:
        raise UsageError(
            f"--only names {', '.join(unknown) or 'nothing'}; choose from "
            f"{','.join(item.name for item in ITEMS)}"
        )
    return tuple(item for item in ITEMS if item.name in names)
