"""A sweep from plan to files: the table does not depend on executor, interruption or storage."""

import csv
import errno
import hashlib
import json
import math
import os
import signal
import threading
from concurrent.futures import Executor, Future
from contextlib import contextmanager, nullcontext
from typing import Any

import h5py
import numpy as np
import pytest
from pyarrow import parquet
from support.waiting import ended

from daq_service.cli.sweep import outputs as outputs_module
from daq_service.cli.sweep import run as run_module
from daq_service.cli.sweep.execution import ROWS_PER_TASK, group_rows_into_tasks
from daq_service.cli.sweep.plan import build_plan
from daq_service.cli.sweep.run import SweepOptions, run_sweep
from daq_service.cli.sweep.shot import NO_REFLECTION, OK, RESULTS, compute_rows, summarise_coupled_shot
from daq_service.cli.sweep.specification import parse_axis
from daq_service.cli.sweep.work_file import build_work_file_path, open_work_file
from daq_service.errors import BusyError, StorageError, UsageError
from daq_service.processes import executors
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel

# A coarse mesh: these tests are about tables. The analytic plate needs none.
BASE = ChainParameters(), PlateParameters(elements_per_edge=16), CorrosionParameters()
ANALYTIC = ChainParameters(), PlateParameters(model="infinite_kirchhoff"), CorrosionParameters()
MIXED = (
    "plate.model=mindlin,infinite_kirchhoff",
    "chain.sensor=sphere,disk",
    "chain.drop_height_m=3e-3,5e-3",
)
HEIGHTS = ("chain.drop_height_m=0.003:0.008:40",)


def planned(*specifications, base=BASE, **options):
    return build_plan("coupled", base, [parse_axis(text) for text in specifications], **options)


def sweep_table(plan, stop=None, **options):
    return run_sweep(plan, SweepOptions(**{"executor": "threads", **options}), {}, stop or threading.Event())


class InlineExecutor(Executor):
    """Executor double that computes in this thread, records the tasks, and calls a hook after each."""

    def __init__(self, after_task):
        self.indices: list[int] = []
        self._after_task = after_task

    def submit(self, fn, /, *args, **kwargs):
        model, rows, waveforms = args
        self.indices += [index for index, _ in rows]
        future: Future[Any] = Future()
        future.set_result(fn(model, rows, waveforms))
        self._after_task()
        return future


def recording(monkeypatch, after_task=lambda: None):
    executor = InlineExecutor(after_task)

    @contextmanager
    def opened(kind, workers):
        yield executor

    monkeypatch.setattr(run_module, "open_executor", opened)
    return executor


def interrupt_sweep(monkeypatch, plan, output):
    """Stop a sweep after its first tasks; return the indices of the computed rows."""
    stop = threading.Event()
    executor = recording(monkeypatch, stop.set)
    with pytest.raises(KeyboardInterrupt):
        sweep_table(plan, stop, outputs=(output,))
    assert 0 < len(executor.indices) < len(plan.rows)
    return executor.indices


def test_each_row_is_the_single_shot_to_the_last_bit():
    # So high a drop has its own time step: preparations for one height may not fit another.
    plan = planned(*MIXED[:2], "chain.drop_height_m=5e-3,1", "chain.tilt_rad=0,0.02")
    table = sweep_table(plan, workers=2)
    assert len(set(table.results["step_s"])) > 1
    for row, found in zip(plan.rows, table.rows(), strict=True):
        assert row.specimen is not None
        alone = summarise_coupled_shot(row.specimen, ShotModel(*row.specimen).shot(contact_forces=True))
        for name in RESULTS["coupled"]:
            assert found[name] == alone[name], (name, row.values)
        assert found["status"] == OK
        assert found["chain.tilt_rad"] == row.values[-1]


@pytest.mark.parametrize(
    ("executor", "workers"), [("threads", 2), pytest.param("processes", 2, marks=pytest.mark.slow)]
)
def test_the_hash_does_not_depend_on_executor_and_workers(executor, workers):
    plan = planned(*MIXED)
    alone = sweep_table(plan, workers=1)
    assert (
        alone.facts["content_hash"]
        == sweep_table(plan, executor=executor, workers=workers).facts["content_hash"]
    )
    one_bit = np.nextafter(0.003, 1.0)
    other = planned(*MIXED[:2], f"chain.drop_height_m={one_bit!s},5e-3")
    assert sweep_table(other).facts["content_hash"] != alone.facts["content_hash"]


def test_a_worker_ignores_ctrl_c_and_ends_with_its_parent(monkeypatch):
    class Parent:
        def join(self):
            calls.append("the parent has ended")

    calls: list[object] = []
    monkeypatch.setattr("multiprocessing.parent_process", Parent)
    monkeypatch.setattr(os, "_exit", calls.append)
    monkeypatch.setattr(executors, "use_one_blas_thread", nullcontext)
    before, threads = signal.getsignal(signal.SIGINT), set(threading.enumerate())
    try:
        executors.prepare_worker()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
        for watcher in set(threading.enumerate()) - threads:
            ended(watcher, "the end of the worker's watch over its parent")
    assert calls == ["the parent has ended", 1]


def test_an_interrupted_sweep_continues_without_repeated_rows(monkeypatch, tmp_path, capsys):
    plan = planned(*HEIGHTS, base=ANALYTIC, waveforms=True)
    whole, output = tmp_path / "whole.h5", tmp_path / "stopped.h5"
    sweep_table(plan, outputs=(whole,))
    done = interrupt_sweep(monkeypatch, plan, output)
    assert f"{len(done)} of 40 rows are kept in {build_work_file_path(output)}; the same command goes on" in (
        capsys.readouterr().err
    )
    assert not output.exists()
    again = recording(monkeypatch)
    sweep_table(plan, outputs=(output,))
    assert sorted([*done, *again.indices]) == list(range(40))
    assert output.read_bytes() == whole.read_bytes(), "waveforms, too"
    assert not build_work_file_path(output).exists()


def test_a_torn_or_corrupt_line_is_computed_again(monkeypatch, tmp_path):
    plan = planned(*HEIGHTS, base=ANALYTIC)
    output = tmp_path / "table.csv"
    done = interrupt_sweep(monkeypatch, plan, output)
    work = build_work_file_path(output)
    header, first, second, *others = work.read_bytes().splitlines(keepends=True)
    changed = first.replace(b'"status":"ok"', b'"status":"OK"')
    assert changed != first
    work.write_bytes(b"".join([header, changed, second, *others[:-1], others[-1][:-20]]))
    lost = {json.loads(line.partition(b" ")[2])["row"] for line in (first, others[-1])}
    kept = {*done} - lost
    with open_work_file(work, plan) as opened:
        assert (set(opened.finished), opened.damaged_lines) == (kept, 1)
        row = plan.rows[min(lost)]
        assert row.specimen is not None
        opened.keep(compute_rows("coupled", [(row.index, row.specimen)]))
    kept.add(min(lost))
    again = recording(monkeypatch)
    table = sweep_table(plan, outputs=(output,))
    assert sorted(again.indices) == sorted({*range(40)} - kept), "nothing was appended to the torn line"
    assert table.facts["content_hash"] == sweep_table(plan).facts["content_hash"]


def test_a_work_file_of_another_sweep_or_in_use_is_refused(monkeypatch, tmp_path):
    plan = planned(*HEIGHTS, base=ANALYTIC)
    output = tmp_path / "table.csv"
    interrupt_sweep(monkeypatch, plan, output)
    before = build_work_file_path(output).read_bytes()
    other = planned("chain.drop_height_m=0.003:0.008:41", base=ANALYTIC)
    with pytest.raises(StorageError, match=r"another sweep.*remove the file"):
        sweep_table(other, outputs=(output,))
    assert build_work_file_path(output).read_bytes() == before
    with open_work_file(build_work_file_path(output), plan), pytest.raises(BusyError, match="is running"):
        sweep_table(plan, outputs=(output,))


def test_csv_hdf5_and_parquet_hold_the_same_table(tmp_path):
    paths = [tmp_path / name for name in ("t.csv", "t.h5", "t.parquet")]
    plan = planned(
        "plate.model=rigid_wall,infinite_kirchhoff",
        "chain.spheres_below=3,4",
        "corrosion.depth_fraction=0,0.1",
        base=ANALYTIC,
        skip_invalid=True,
        waveforms=True,
    )
    table = sweep_table(plan, outputs=tuple(paths), skip_invalid=True)
    assert [status.partition(":")[0] for status in table.status] == [OK, "invalid"] * 4

    raw = paths[0].read_bytes()
    assert raw.count(b"\r\n") == 9
    assert raw.count(b"\n") == 9
    with paths[0].open(encoding="utf-8", newline="") as file:
        from_csv = list(csv.DictReader(file))
    from_parquet = parquet.read_table(paths[2])
    with h5py.File(paths[1]) as file:
        entry = file["entry"]
        order = [
            name for group in ("swept", "results") for name in entry[group].attrs["column_order"].astype(str)
        ]
        assert [*order, "status"] == list(table.columns) == from_parquet.column_names == list(from_csv[0])
        for name in order:
            field = entry["swept" if name in table.swept else "results"][name]
            stored = field[()]
            if stored.dtype.kind == "S":
                texts = [text.decode() for text in stored]
                assert texts == table.columns[name] == [row[name] for row in from_csv]
                assert texts == from_parquet[name].to_pylist()
                continue
            expected = np.asarray(table.columns[name])
            cells = np.array([float(row[name] or "nan") for row in from_csv])
            assert np.array_equal(stored, expected, equal_nan=True)
            assert np.array_equal(cells, expected, equal_nan=True)
            assert np.array_equal(from_parquet[name].to_numpy(), expected, equal_nan=True)
        assert entry["results/tof_us"].attrs["units"] == "us"
        assert (
            [text.decode() for text in entry["status"][()]]
            == table.status
            == from_parquet["status"].to_pylist()
        )
        first, count = entry["waveforms/first_sample"][()], entry["waveforms/n_samples"][()]
        assert (count > 0).tolist() == [True, False] * 4
        assert plan.rows[4].specimen is not None
        alone = ShotModel(*plan.rows[4].specimen).shot()
        force = entry["waveforms/force_n"][first[4] : first[4] + count[4]]
        assert np.array_equal(force, alone.force_n)
        assert entry["waveforms/sample_interval_s"][4] == alone.time_s[1]
        facts = [json.loads(entry["facts"][()]), json.loads(from_parquet.schema.metadata[b"solimon"])]
    facts.append(json.loads((tmp_path / "t.csv.json").read_text(encoding="utf-8")))
    assert facts[0] == facts[1] == facts[2] == dict(table.facts)
    assert {"solimon_version", "versions", "content_hash", "code_sha256"} <= set(facts[0])


def test_the_content_hash_can_be_made_again_from_the_table():
    table = sweep_table(planned("chain.drop_height_m=0.004,0.005", base=ANALYTIC))
    names = list(table.columns)
    lines = [names, *([row[name] for name in names] for row in table.rows())]
    text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines)
    assert hashlib.sha256(text.encode()).hexdigest() == table.facts["content_hash"]


def test_a_row_without_numbers_has_a_reason_and_stops_no_other():
    # The impact of so slow a striker is lost in the rounding of the chain's static energy.
    plan = planned("chain.drop_height_m=5e-3,1e-12", base=ANALYTIC)
    table = sweep_table(plan)
    good, lost = table.rows()
    assert good["status"] == OK
    assert "energy balance is off" in lost["status"]
    assert all(lost[name] is None for name in RESULTS["coupled"])
    assert table.facts["rows_ok"] == 1


def test_contradicting_parameters_end_the_sweep_or_become_a_row():
    plan = planned("corrosion.size_m=0.0254,0.7")
    with pytest.raises(UsageError, match=r"row 2 \(corrosion\.size_m = 0\.7\) is refused: .*--skip-invalid"):
        sweep_table(plan)
    good, refused = sweep_table(plan, skip_invalid=True).rows()
    assert good["status"] == OK
    assert refused["status"].startswith("invalid: ")
    assert refused["tof_us"] is None


def test_results_are_not_overwritten_by_default(tmp_path):
    plan = planned("chain.drop_height_m=0.004,0.005", base=ANALYTIC)
    output = tmp_path / "table.csv"
    sweep_table(plan, outputs=(output,))
    before = output.read_bytes()
    with pytest.raises(UsageError, match=r"table\.csv\S* exists; .*--overwrite"):
        sweep_table(plan, outputs=(output,))
    output.unlink()
    with pytest.raises(UsageError, match=r"table\.csv\.json exists"):
        sweep_table(plan, outputs=(output,))
    sweep_table(plan, outputs=(output,), overwrite=True)
    assert output.read_bytes() == before


def test_a_full_disk_keeps_finished_rows_and_leaves_no_half_file(monkeypatch, tmp_path):
    plan = planned("chain.drop_height_m=0.004,0.005", base=ANALYTIC)
    outputs = (tmp_path / "table.csv", tmp_path / "table.h5")

    def full(descriptor, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        with pytest.raises(StorageError, match="finished rows are kept") as caught:
            sweep_table(plan, outputs=outputs)
    assert caught.value.exit_code == 4
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv.work"]
    # As if it had ended between the outputs: those of this very sweep are written again.
    (tmp_path / "table.csv").write_text("half", encoding="utf-8")
    again = recording(monkeypatch)
    sweep_table(plan, outputs=outputs)
    assert again.indices == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["table.csv", "table.csv.json", "table.h5"]


@pytest.mark.parametrize(
    ("names", "waveforms", "error", "message"),
    [
        (["t.xlsx"], False, UsageError, r"\.csv, \.h5, \.hdf5, \.parquet"),
        (["t.csv", "t.csv"], False, UsageError, "twice"),
        (["t.csv"], True, UsageError, "HDF5 only"),
        (["absent/t.csv"], False, StorageError, "no folder"),
        (["folder.csv"], False, StorageError, "is a folder"),
    ],
)
def test_impossible_outputs_are_rejected_first(names, waveforms, error, message, tmp_path):
    (tmp_path / "folder.csv").mkdir()
    plan = planned("chain.drop_height_m=0.004", base=ANALYTIC, waveforms=waveforms)
    with pytest.raises(error, match=message):
        sweep_table(plan, outputs=tuple(tmp_path / name for name in names))


def test_parquet_without_its_package_names_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(UsageError, match=r"pip install 'solimon\[parquet\]'"):
        outputs_module.check_outputs([tmp_path / "t.parquet"], waveforms=False)


def test_a_chain_too_far_from_its_reflection_is_a_row_of_its_own_kind():
    # Nearly all of the wave goes into a thin large plate: lambda is about 50.
    plan = planned("plate.thickness_m=4e-4", "chain.contact_damping_n_s_per_m=0", base=ANALYTIC)
    (row,) = sweep_table(plan).rows()
    assert row["status"] in (OK, NO_REFLECTION)
    assert (row["tof_us"] is None) == (row["status"] == NO_REFLECTION)
    assert math.isfinite(row["isw_peak_n"])


def test_rows_of_a_plate_go_together_and_every_plate_begins_first():
    plan = planned(
        "chain.drop_height_m=0.003:0.008:12",
        "plate.thickness_m=0.004,0.006",
        "corrosion.depth_fraction=0,0.3",
    )
    tasks = group_rows_into_tasks(plan.rows, workers=1)
    assert sorted(row.index for task in tasks for row in task) == list(range(48))
    # 48 rows in 16 tasks, none larger; a plate has 24 of them.
    assert {len(task) for task in tasks} == {3}
    assert [task[0].values[1] for task in tasks] == [0.004, 0.006, *[0.004] * 7, *[0.006] * 7]
    assert all(len({row.values[1] for row in task}) == 1 for task in tasks)
    heights = [row.values[0] for task in tasks if task[0].values[1] == 0.004 for row in task]
    assert heights == sorted(heights), "depths of a chain follow each other"
    assert max(len(task) for task in group_rows_into_tasks(plan.rows * 10, workers=1)) == ROWS_PER_TASK
