"""Where a set comes from: configuration, rig, machine and versions, stored in every file."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

from daq_service.catalogue.rows import ExperimentRow
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig
from simulator.parameters.experiment import TWIN_VERSION

PACKAGES = ("solimon", "numpy", "scipy", "h5py")


def build_provenance(settings: Settings, rig: Rig, *, experiment: ExperimentRow) -> dict[str, Any]:
    """Build the provenance that is stored with every set of a run, ready for JSON.

    It has configuration and its hash, experiment, rig, host, platform, Python and package versions.

    Parameters
    ----------
    experiment
        The folder's: all its files bear the hash of the configuration that began it, though a later version's
        configuration has more keys, and its hour 0.
    """
    versions = {name: version(name) for name in PACKAGES}
    if settings.rig.on_twin:
        versions |= {"numba": version("numba"), "twin": TWIN_VERSION}
    return {
        "configuration": settings.model_dump(mode="json"),
        "configuration_hash": experiment.configuration_hash,
        "experiment": {name: getattr(experiment, name) for name in ("name", "uuid", "site", "epoch_utc_ns")},
        "rig_identity": dict(rig.identity),
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "versions": versions,
    }
