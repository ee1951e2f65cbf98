"""A Dask cluster of two workers on this computer: tasks of which one kills its worker, a sweep, a replay.

``python -m support.local_cluster FOLDER`` prints what came of it as JSON.
"""

from __future__ import annotations

import json
import logging
import sys
import threading
from pathlib import Path
from typing import Any

from distributed import LocalCluster

from daq_service.cli.offline.evidence.replay import replay_test
from daq_service.cli.sweep.plan import build_plan
from daq_service.cli.sweep.run import SweepOptions, run_sweep
from daq_service.cli.sweep.specification import parse_axis
from daq_service.processes.executors import count_workers, open_executor
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from support.drifting_wall import drifting_wall
from support.dying_worker import die_once

ANALYTIC = ChainParameters(), PlateParameters(model="infinite_kirchhoff"), CorrosionParameters()


def _swept(executor: str) -> str:
    plan = build_plan("coupled", ANALYTIC, [parse_axis("chain.drop_height_m=0.003:0.008:20")])
    options = SweepOptions(executor=executor, workers=2)
    return str(run_sweep(plan, options, {}, threading.Event()).facts["content_hash"])


def main(folder: Path) -> dict[str, Any]:
    """Run sweeps and replays on a local cluster; print the results as JSON."""
    line = drifting_wall(folder)
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=logging.ERROR
    ) as cluster:
        name = cluster.scheduler_address.replace("tcp://", "dask://")
        with open_executor(name, 1) as executor:
            futures = [executor.submit(die_once, folder / "noted", number) for number in range(6)]
            results: dict[str, Any] = {
                "workers": count_workers(executor, 1),
                "done": [future.result() for future in futures],
                "died": (folder / "noted").exists(),
            }
        results["sweep"] = {"cluster": _swept(name), "threads": _swept("threads")}
        results["replay"] = [
            {"sets": found.sets, "differences": found.differences, "kept": len(found.alarms.kept)}
            for found in (replay_test(line.folder, (), extract_by=by) for by in ((name, 1), ("processes", 2)))
        ]
    return results


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
