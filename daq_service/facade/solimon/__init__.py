"""Solimon in Python: open a test for reading, from its data folder or its service.

>>> import solimon
>>> with solimon.open("my-test-data") as test:
...     features = test.features("B")
"""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from daq_service.processes.installation import refuse_hidden_packages

if TYPE_CHECKING:
    from daq_service.client import ClientError, Event, Experiment, RefusedError, UnreachableError
    from daq_service.client import open as open  # noqa: A004 - read as solimon.open

__all__ = ["ClientError", "Event", "Experiment", "RefusedError", "UnreachableError", "__version__", "open"]

refuse_hidden_packages()
__version__ = version("solimon")


def __getattr__(name: str) -> Any:
    """Import a name of `daq_service.client` on first use; MissingExtraError names the extra it needs."""
    if name not in __all__:
        raise AttributeError(f"module 'solimon' has no attribute {name!r}")
    from daq_service import client

    return getattr(client, name)
