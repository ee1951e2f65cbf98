"""The catalogue: what was taken, what it says, what was decided; SQLite through SQLAlchemy Core.

`open_catalogue` is the door. The recorder opens it with ``writer=True``; everybody else reads, and
may add commands. The names are imported when they are first used: `network_folder` needs no SQL.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq_service.catalogue.reader import Catalogue
    from daq_service.catalogue.store import check_owner, open_catalogue
    from daq_service.catalogue.writer import Committed, RecorderCatalogue, SetCommit

__all__ = ["Catalogue", "Committed", "RecorderCatalogue", "SetCommit", "check_owner", "open_catalogue"]

_MODULE_OF = {
    "Catalogue": "reader",
    "check_owner": "store",
    "open_catalogue": "store",
    "Committed": "writer",
    "RecorderCatalogue": "writer",
    "SetCommit": "writer",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
