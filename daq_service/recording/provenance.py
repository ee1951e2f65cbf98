"""Where a set comes from: configuration, rig, machine and versions, stored in every file."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig

PACKAGES = ("solimon", "numpy", "scipy", "h5py", "numba")


def provenance(settings: Settings, rig: Rig) -> dict[str, Any]:
    """JSON-ready; the same for every set of a run."""
    return {
        "configuration": settings.model_dump(mode="json"),
        "configuration_hash": settings.configuration_hash(),
        "rig_identity": dict(rig.identity),
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
    }
