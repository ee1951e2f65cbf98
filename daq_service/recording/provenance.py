"""Where a set comes from: configuration, rig, machine and versions, stored in every file."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig
from simulator.parameters.experiment import TWIN_VERSION

PACKAGES = ("solimon", "numpy", "scipy", "h5py", "numba")


def provenance(settings: Settings, rig: Rig, *, configuration_hash: str) -> dict[str, Any]:
    """JSON-ready; the same for every set of a run.

    Parameters
    ----------
    configuration_hash
        The folder's, of the configuration that began it: all its files bear one name, though a later
        version's configuration has more keys.
    """
    versions = {name: version(name) for name in PACKAGES}
    return {
        "configuration": settings.model_dump(mode="json"),
        "configuration_hash": configuration_hash,
        "rig_identity": dict(rig.identity),
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "versions": {**versions, "twin": TWIN_VERSION} if settings.rig.on_twin else versions,
    }
