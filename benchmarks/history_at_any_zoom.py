"""History of a million sets at one position, ten million rows, during writing: any range at any zoom.

    python benchmarks/history_at_any_zoom.py [--folder F] [--sets N] [--answers N] [--json]

A kept ``--folder`` is filled once, by `commit_set` as a recorder does. Ranges of every width, from one set to
the whole test, are asked as the dashboard does, of the application without a socket, while another process
stores a set twenty times a second. "grouped" is the obvious way to such a picture, measured next to it: SQL
that groups the range's rows, with the same index, into as many bins. Outliers are planted in the test: each
answer must tell every one of its range.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import random
import sqlite3
import statistics
import sys
import tempfile
import time
from contextlib import closing
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from analysis.waves.features import EXTRACTOR_VERSION
from daq_service.catalogue import SetCommit, open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.rows import AssessmentRow, FeatureRow, SetRow, ShotRow
from daq_service.settings.tree import Settings
from daq_service.web.app import create_app
from daq_service.web.routes.trends import MOST_POINTS
from hardware_drivers.nanoseconds import NS_PER_H

SETS, SETS_A_COMMIT, SHOTS = 1_000_000, 500, 7
"""Set, mean features, assessment and seven shots: ten rows per set."""
INTERVAL_H = 0.1
FIELDS = ("tof_pp_s", "distance_squared", "limit_f_predictive", "outlier")
"""What a chart of the dashboard asks for."""
OUTLIER_EVERY = 9973
PERIOD_S = 0.05
GROUPED = """
SELECT v.set_index / :width, min(f.tof_pp_s), max(f.tof_pp_s), avg(f.tof_pp_s),
       min(v.distance_squared), max(v.distance_squared), avg(v.distance_squared), max(v.outlier), count(*)
FROM features f JOIN assessments v USING (position, set_index, unscheduled_index)
WHERE f.position = 'B' AND f.shot_index IS NULL AND f.set_index BETWEEN :first AND :last
  AND f.unscheduled_index = 0
GROUP BY 1
"""


def one_position() -> Settings:
    """Return a test with a set every six minutes without end."""
    phases = [{"until_h": 1000.0, "interval_h": INTERVAL_H}]
    return Settings(positions={"B": {"method": "solitary_wave"}}, schedule={"phases": phases})


def add_set(commit: SetCommit, index: int, rng: np.random.Generator) -> None:
    """Add the rows of a set to a commit."""
    due_h = INTERVAL_H * (index + 1)
    due_utc_ns = round(due_h * NS_PER_H)
    own: dict[str, Any] = {"position": "B", "set_index": index}
    tof_s, distance = 3.3e-4 * (1.0 + 0.01 * rng.standard_normal()), float(rng.chisquare(5))
    outlier = index % OUTLIER_EVERY == OUTLIER_EVERY - 1
    commit.sets.append(
        SetRow(
            **own, due_h=due_h, method="solitary_wave", due_utc_ns=due_utc_ns, state="done", n_planned=SHOTS,
            n_taken=SHOTS, n_valid=SHOTS,
        )
    )  # fmt: skip
    commit.features.append(
        FeatureRow(
            **own, due_h=due_h, shot_index=None, sequence=None, extractor_version=EXTRACTOR_VERSION,
            quality="good", n_valid=SHOTS, tof_pp_s=tof_s, tof_ac_s=tof_s, tof_mf_s=tof_s,
            amplitude_ratio=0.5, autocorrelation_coefficient=0.6, psw_area_v_s=1e-4,
        )
    )  # fmt: skip
    commit.assessments.append(
        AssessmentRow(
            **own, due_h=due_h, in_baseline=index < 48, distance_squared=400.0 if outlier else distance,
            limit_name="f_predictive", limit_f_predictive=24.3, outlier=None if index < 48 else outlier,
        )
    )  # fmt: skip
    for shot in range(SHOTS):
        commit.shots.append(
            ShotRow(
                **own, sequence=index * SHOTS + shot + 1, shot_index=shot, attempt=0, crc32=shot, flags=[],
                utc_ns=due_utc_ns + shot, mono_ns=shot, boot_id="simulated", valid=True,
            )
        )  # fmt: skip


def fill(folder: Path, n_sets: int) -> None:
    """Store the sets, many per transaction."""
    settings, rng = one_position(), np.random.default_rng(0)
    with open_catalogue(folder, writer=True) as catalogue:
        catalogue.create_experiment(
            name=settings.name,
            configuration_hash=settings.configuration_hash(),
            configuration=settings.model_dump(mode="json"),
            epoch_utc_ns=0,
            clock="simulated",
            solimon_version="0",
        )
        for first in range(0, n_sets, SETS_A_COMMIT):
            commit = SetCommit()
            for index in range(first, min(first + SETS_A_COMMIT, n_sets)):
                add_set(commit, index, rng)
            catalogue.commit_set(commit)
            print(f"\r{first + SETS_A_COMMIT} of {n_sets} sets", end="", file=sys.stderr)
        print(file=sys.stderr)


def write_sets(folder: Path, first: int, stop: Event) -> None:
    """Store a set every `PERIOD_S` until stopped."""
    rng = np.random.default_rng(first)
    with open_catalogue(folder, writer=True, settings=one_position()) as catalogue:
        while not stop.wait(PERIOD_S):
            commit = SetCommit()
            add_set(commit, first, rng)
            catalogue.commit_set(commit)
            first += 1


def ranges(n_sets: int, count: int) -> list[tuple[int, int]]:
    """Return ranges of sets, of every width equally, from one to all of them."""
    chance, found = random.Random(0), [(0, n_sets - 1)]
    for _ in range(count - 1):
        width = round(n_sets ** chance.random())
        first = chance.randrange(n_sets - width + 1)
        found.append((first, first + width - 1))
    return found


async def measure_answers(folder: Path, asked_for: list[tuple[int, int]]) -> list[tuple[float, int]]:
    """Return seconds and bytes of each answer, after a check for the planted outliers."""
    taken, app = [], create_app(one_position(), folder)
    async with (
        app.router.lifespan_context(app),
        httpx2.AsyncClient(transport=httpx2.ASGITransport(app), base_url="http://127.0.0.1") as client,
    ):
        await client.get("/api/v1/trends/B?points=1")  # what is loaded once
        for first, last in asked_for:
            # Half an interval around: hours are rounded.
            from_h, to_h = INTERVAL_H * (first + 0.5), INTERVAL_H * (last + 1.5)
            parameters: dict[str, Any] = {"fields": ",".join(FIELDS), "points": MOST_POINTS}
            began = time.perf_counter()
            answer = await client.get(
                "/api/v1/trends/B", params={**parameters, "from_h": from_h, "to_h": to_h}
            )
            taken.append((time.perf_counter() - began, len(answer.content)))
            answer.raise_for_status()
            require_outliers(answer.json(), first, last)
    return taken


def require_outliers(trend: dict[str, Any], first: int, last: int) -> None:
    """Raise for an answer that hides an outlier."""
    planted = (last + 1) // OUTLIER_EVERY - max(first, 48) // OUTLIER_EVERY
    columns, bins = trend["columns"], trend["bins"]
    n_outliers = sum(bins["n_outliers"]) if bins else sum(map(bool, columns["outlier"]))
    if n_outliers != planted or (planted and not any(columns["outlier"])):
        raise SystemExit(f"sets {first} to {last} have {planted} outliers, the answer tells {n_outliers}")


def measure_statements(folder: Path, asked_for: list[tuple[int, int]]) -> list[float]:
    """Return seconds of each range by one statement."""
    taken = []
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        for first, last in asked_for:
            width = max(1, -(-(last - first + 1) // MOST_POINTS))
            began = time.perf_counter()
            connection.execute(GROUPED, {"width": width, "first": first, "last": last}).fetchall()
            taken.append(time.perf_counter() - began)
    return taken


def measure(folder: Path, n_sets: int, n_answers: int) -> dict[str, float]:
    """Measure answers while another process writes."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        (n_stored,) = connection.execute("SELECT max(set_index) + 1 FROM sets").fetchone()
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type='table'")]
        n_rows = sum(connection.execute(f'SELECT count(*) FROM "{name}"').fetchone()[0] for name in tables)
    asked_for, stop = ranges(n_sets, n_answers), multiprocessing.get_context("spawn").Event()
    writer = multiprocessing.get_context("spawn").Process(target=write_sets, args=(folder, n_stored, stop))
    writer.start()
    try:
        answers = asyncio.run(measure_answers(folder, asked_for))
        plain = measure_statements(folder, asked_for)
    finally:
        stop.set()
        writer.join()
    seconds = [second for second, _ in answers]
    return {
        "sets": n_sets,
        "rows": n_rows,
        "answers": n_answers,
        "median_ms": 1e3 * statistics.median(seconds),
        "p99_ms": 1e3 * float(np.quantile(seconds, 0.99)),
        "largest_kb": max(length for _, length in answers) / 1e3,
        "grouped_median_ms": 1e3 * statistics.median(plain),
        "grouped_p99_ms": 1e3 * float(np.quantile(plain, 0.99)),
    }


def main() -> None:
    """Fill the folder if necessary, measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr] # it is there
    parser.add_argument("--folder", type=Path, help="kept; filled once")
    parser.add_argument("--sets", type=int, default=SETS)
    parser.add_argument("--answers", type=int, default=400)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.folder or Path(temporary)
        if not (folder / FILE_NAME).exists():
            folder.mkdir(parents=True, exist_ok=True)
            fill(folder, chosen.sets)
        found = measure(folder, chosen.sets, chosen.answers)
    if chosen.json:
        print(json.dumps(found))
        return
    ratio = {key: found[f"grouped_{key}"] / found[key] for key in ("median_ms", "p99_ms")}
    print(f"{found['sets']:,} sets at a position, {found['rows']:,} rows, a set written every {PERIOD_S:g} s")
    print(f"largest answer {found['largest_kb']:.0f} kB")
    print(f"trends     median {found['median_ms']:9.1f} ms   p99 {found['p99_ms']:9.1f} ms")
    print(f"grouped    median {found['grouped_median_ms']:9.1f} ms   p99 {found['grouped_p99_ms']:9.1f} ms")
    print(f"ratio      median {ratio['median_ms']:9.2f}      p99 {ratio['p99_ms']:9.2f}")


if __name__ == "__main__":
    main()
