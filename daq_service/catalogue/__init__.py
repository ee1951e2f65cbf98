"""The catalogue: sets, results and decisions of a test; SQLite through SQLAlchemy Core.

Open it with `open_catalogue`. The recorder uses ``writer=True``; all others read and may add commands.
The names are imported on first use: `network_folder` needs no SQL.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

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


def __getattr__(name: str) -> object:
    """Import a name of the package on first use; raise AttributeError for a name that it does not have."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
