"""Time of flight and amplitude ratio over depth: every model of the plate, both sensors, both patches.

    python benchmarks/models_over_depth.py [--models mindlin ...] [--json] [--write]

Noise-free sensor force, the paper's chain and plate; static preload kept, but in `dynamic_amplitude_ratio`,
which is in the CSV file only. Next to each number stands what a
finer mesh and a quarter of the step change in it. `zener` and `infinite_kirchhoff` know no patch: the whole
plate is as thin as the depth leaves it. `--write` renews docs/reference/models-over-depth.{csv,md}, which a
test compares with the models. Takes some minutes with the solid plate.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

# Small dense problems: BLAS threads only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from simulator.errors import SpecimenError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters, SolidMesh
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.zener.model import compute_reflection

REFERENCE = Path(__file__).resolve().parent.parent / "docs" / "reference"
DEPTHS = tuple(k / 10 for k in range(9))
PATCHES_M = {"B": 25.4e-3, "C": 50.8e-3}
SENSORS = ("disk", "sphere")
STEP_S = 0.5e-6
COLUMNS = (
    "model",
    "patch",
    "sensor",
    "depth_fraction",
    "tof_us",
    "amplitude_ratio",
    "dynamic_amplitude_ratio",
    "tof_change_us",
    "ratio_change",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Plate, and the same one meshed more finely; references have no mesh."""

    plate: PlateParameters
    finer: PlateParameters | None = None
    has_patch: bool = True


MINDLIN = PlateParameters()
SPREAD = PlateParameters(contact="patch")
SOLID = PlateParameters(model="solid")
FINER_SOLID = SolidMesh(degree=5, edge_element=0.025, growth=1.7)
MODELS = {
    "mindlin": Model(plate=MINDLIN, finer=replace(MINDLIN, elements_per_edge=192)),
    "mindlin, patch contact": Model(
        plate=SPREAD, finer=replace(SPREAD, elements_per_edge=192, contact_element_m=5e-5)
    ),
    "solid": Model(plate=SOLID, finer=replace(SOLID, solid=FINER_SOLID)),
    "infinite_kirchhoff": Model(plate=PlateParameters(model="infinite_kirchhoff"), has_patch=False),
    "rigid_wall": Model(plate=PlateParameters(model="rigid_wall"), has_patch=False),
}
ZENER = "zener"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Line of the table; changes are None where there is nothing to refine."""

    model: str
    patch: str
    sensor: str
    depth_fraction: float
    tof_us: float
    amplitude_ratio: float
    dynamic_amplitude_ratio: float
    tof_change_us: float | None = None
    ratio_change: float | None = None


def rows_of(name: str) -> Iterator[Row]:
    """Yield every depth, patch and sensor of one model."""
    if name == ZENER:
        yield from zener_rows()
        return
    model = MODELS[name]
    for patch, size_m in PATCHES_M.items() if model.has_patch else [("whole plate", None)]:
        for sensor in SENSORS:
            chain = ChainParameters(sensor=sensor)
            values, refined = (
                tof_and_ratio_function(chain, plate, size_m, step) for plate, step in variants(model)
            )
            for depth in DEPTHS:
                if depth and name == "rigid_wall":
                    break
                tof_us, ratio, dynamic_ratio = values(depth)
                finer_tof_us, finer_ratio, _ = refined(depth)
                yield Row(
                    model=name,
                    patch=patch,
                    sensor=sensor,
                    depth_fraction=depth,
                    tof_us=tof_us,
                    amplitude_ratio=ratio,
                    dynamic_amplitude_ratio=dynamic_ratio,
                    tof_change_us=finer_tof_us - tof_us,
                    ratio_change=finer_ratio - ratio,
                )


def variants(model: Model) -> list[tuple[PlateParameters, float]]:
    """Return the model as it is, and refined in space and time."""
    return [(model.plate, STEP_S), (model.finer or model.plate, STEP_S / 4.0)]


def tof_and_ratio_function(
    chain: ChainParameters, plate: PlateParameters, size_m: float | None, step_s: float
) -> Callable[[float], tuple[float, float, float]]:
    """Return a function of the depth that returns what `tof_and_ratio` returns."""
    if size_m is not None:
        model = ShotModel(chain, plate, CorrosionParameters(size_m=size_m), step_s=step_s)
        return lambda depth: tof_and_ratio(model, depth)
    return lambda depth: tof_and_ratio(
        ShotModel(
            chain,
            replace(plate, thickness_m=plate.thickness_m * (1.0 - depth)),
            CorrosionParameters(),
            step_s=step_s,
        ),
        0.0,
    )


def tof_and_ratio(model: ShotModel, depth: float) -> tuple[float, float, float]:
    """Return time of flight in us and amplitude ratio of one shot, with and without the static preload."""
    pulses = summarise_pulses(model.shot(depth_fraction=depth))
    found = pulses.tof_us, pulses.amplitude_ratio, pulses.dynamic_amplitude_ratio
    tof_us, ratio, dynamic_ratio = (math.nan if value is None else value for value in found)
    return tof_us, ratio, dynamic_ratio


def zener_rows() -> Iterator[Row]:
    """Yield the paper's analytical model within its range; it has no sensor and no patch."""
    for depth in DEPTHS:
        try:
            found = compute_reflection(ChainParameters(), PlateParameters(), depth_fraction=depth)
        except SpecimenError as error:
            print(f"\n{ZENER} ends at {depth:.0%}: {error}", file=sys.stderr)
            return
        yield Row(
            model=ZENER,
            patch="whole plate",
            sensor="none",
            depth_fraction=depth,
            tof_us=1e6 * found.tof_s,
            amplitude_ratio=found.amplitude_ratio,
            dynamic_amplitude_ratio=found.amplitude_ratio,  # of an impact without static force
        )


def table(names: list[str]) -> list[Row]:
    """Return all rows, with progress."""
    found: list[Row] = []
    for name in names:
        for row in rows_of(name):
            found.append(row)
            if row.depth_fraction == DEPTHS[-1]:
                print(f"{name}: {row.patch}, {row.sensor} done", file=sys.stderr)
    return found


def as_csv(rows: list[Row]) -> str:
    """Return all rows with their significant digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        changes = row.tof_change_us, row.ratio_change
        writer.writerow(
            [row.model, row.patch, row.sensor, f"{row.depth_fraction:.1f}"]
            + [f"{row.tof_us:.3f}", f"{row.amplitude_ratio:.5f}", f"{row.dynamic_amplitude_ratio:.5f}"]
            + ["" if change is None else f"{change:.1e}" for change in changes]
        )
    return text.getvalue()


def as_markdown(rows: list[Row]) -> str:
    """Return a table per sensor and patch: models down, depths across, worst change at the end."""
    lines = [
        "# Models of the plate over depth",
        "",
        "Time of flight (us) / amplitude ratio of a noise-free shot: the paper's chain and 6.35 mm plate,",
        "static preload kept. Last column: the largest change by a finer mesh and a quarter of the step. B:",
        "25.4 mm square, C: 50.8 mm. Anchors and Zener's model know no patch: the whole plate is as thin as",
        "the depth leaves it. Printed by `python benchmarks/models_over_depth.py --write`, as is",
        "[models-over-depth.csv](models-over-depth.csv), which has the amplitude ratio without preload, too.",
    ]
    for sensor in (*SENSORS, "none"):
        lines += ["", f"## Sensor: {sensor}", ""]
        depths = " | ".join(f"{100 * depth:.0f} %" for depth in DEPTHS)
        lines += [f"| Model | Patch | {depths} | Change |"]
        lines += ["|---|---|" + "---|" * (len(DEPTHS) + 1)]
        for model, patch in dict.fromkeys((row.model, row.patch) for row in rows if row.sensor == sensor):
            matching = [row for row in rows if (row.model, row.patch, row.sensor) == (model, patch, sensor)]
            cells = [
                "no wave back" if math.isnan(row.tof_us) else f"{row.tof_us:.2f} / {row.amplitude_ratio:.4f}"
                for row in matching
            ]
            cells += ["-"] * (len(DEPTHS) - len(matching))
            changes = [
                (abs(row.tof_change_us), abs(row.ratio_change or 0.0))
                for row in matching
                if row.tof_change_us
            ]
            worst = " / ".join(f"{max(column):.1g}" for column in zip(*changes, strict=True)) or "-"
            lines.append(f"| {model} | {patch} | " + " | ".join([*cells, worst]) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    every = [*MODELS, ZENER]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=every, default=every)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true", help="renew the reference tables; needs every model")
    arguments = parser.parse_args()
    if arguments.write and arguments.models != every:
        parser.error("--write needs every model: leave out --models")
    rows = table(arguments.models)
    if arguments.write:
        (REFERENCE / "models-over-depth.csv").write_text(as_csv(rows), encoding="utf-8", newline="\n")
        (REFERENCE / "models-over-depth.md").write_text(as_markdown(rows), encoding="utf-8", newline="\n")
    print(json.dumps([asdict(row) for row in rows]) if arguments.json else as_markdown(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
