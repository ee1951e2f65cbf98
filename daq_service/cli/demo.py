"""``solimon demo``: the paper's experiment through the real recorder, storage, analysis and service."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

from daq_service.catalogue import check_owner
from daq_service.cli.run import STOPPED, plan_children, report_full_disk
from daq_service.cli.summary import format_summary_lines, sum_stage_seconds, summarise_run
from daq_service.cli.terminal import ProgressReport, open_page
from daq_service.errors import EXIT_INTERRUPTED, EXIT_OK
from daq_service.processes.child import log_to_file, stop_on_signals
from daq_service.processes.data_folder import build_new_folder_path, prepare_data_folder, write_configuration
from daq_service.processes.printing import print_line, print_result
from daq_service.processes.supervisor import Message, Supervisor
from daq_service.rig.doubles import run_rig_doubles
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from daq_service.web.port import bind_socket

NUISANCE = "laboratory"
"""Level of the twin's disturbances: a quieter rig than any real one would promise too much."""
WATCHABLE_PACE_H_PER_S = 5.0
"""The 350 h pass in 70 s."""


def run_demo(
    *,
    hours: float | None,
    seed: int | None,
    pace: float | None,
    port: int,
    exit_when_done: bool,
    no_web: bool,
    no_browser: bool,
    data_dir: Path | None,
    rig: str,
    as_json: bool,
) -> int:
    """Run `solimon demo`: block until the test ends, or until Ctrl-C if the dashboard stays open.

    Without ``data_dir`` the data go to a new folder in the working directory. Prints progress and a summary,
    as JSON with ``as_json``. Returns the exit code. Raises UsageError for an invalid option or rig, BusyError
    for a port in use, StorageError for an unusable folder.
    """
    started_s = _read_process_start_s()
    web, stay = not no_web, not exit_when_done and not no_web
    browser = not (no_browser or exit_when_done)
    pace = pace if pace is not None or not stay else WATCHABLE_PACE_H_PER_S
    if web:
        bind_socket(load_settings(None).web.host, port, locked=True).close()
    with run_rig_doubles(rig, _build_overrides(hours, seed, pace)) as running:
        folder = (data_dir or build_new_folder_path("demo")).absolute()
        settings = running.settings
        prepare_data_folder(folder)
        check_owner(settings, folder)
        config = write_configuration(settings, folder)
        log_to_file(folder / "logs" / "supervisor.log")
        with stop_on_signals() as stop:
            with ProgressReport(news_to_stderr=as_json) as progress:
                progress.line(f"data: {folder}")
                report_full_disk(folder, settings.storage, progress.line)
                for note in running.notes:
                    progress.line(note)
                finished = threading.Event()

                def on_message(child: str, message: Message) -> None:
                    """Report a child's message; print the summary at the end of the test if ``stay``."""
                    progress.report_message(child, message)
                    if message["event"] == "listening":
                        opened = ", opened in your browser" if browser and open_page(message["url"]) else ""
                        progress.line(f"dashboard: {message['url']}  (Ctrl-C ends{opened})")
                    elif message["event"] == "stopped":
                        progress.line(STOPPED)
                    elif message["event"] == "finished" and stay:
                        finished.set()
                        for line in format_summary_lines(summarise_run(settings, folder), folder):
                            progress.line(line)
                        progress.line("The test is done; the dashboard stays until Ctrl-C.")

                supervisor = Supervisor(
                    plan_children(
                        config, folder, port=port, web=web, linger=stay, environment=running.environment
                    ),
                    folder,
                    on_message=on_message,
                    give_up=True,
                )
                code = supervisor.run(stop, stay=stay)
            interrupted = stop.is_set()
        if code != EXIT_OK:
            return code
        if interrupted and finished.is_set() and not as_json:
            print_line(f"The test is complete; its data are in {folder}.")
            return EXIT_OK
        if interrupted and not finished.is_set():
            print_line(f"interrupted; what was taken is in {folder}", err=as_json)
            return EXIT_INTERRUPTED
        _print_summary(settings, folder, started_s, as_json=as_json)
        return EXIT_OK


def _print_summary(settings: Settings, folder: Path, started_s: float, *, as_json: bool) -> None:
    """Print the summary of a completed test, with the seconds since the process started (Unix time in s)."""
    summary = summarise_run(settings, folder)
    elapsed_s = time.time() - started_s
    cost = summary["cost"]
    if isinstance(cost, dict):  # starting Python, opening the test, and this summary
        cost["other_processes_s"] = round(elapsed_s - sum_stage_seconds(cost), 3)
    result = {**summary, "elapsed_s": round(elapsed_s, 3), "data_dir": str(folder)}
    lines = [*format_summary_lines(summary, folder), f"done in {elapsed_s:.1f} s"]
    print_result(result, lines, as_json=as_json)


def _build_overrides(
    hours: float | None, seed: int | None, pace: float | None
) -> dict[str, dict[str, object]]:
    """Build the configuration overrides by table and key: `NUISANCE`, and the options that are not None.

    The options are the end of the test in h, the twin's seed, and the pace in h of the test per s.
    """
    options: dict[str, dict[str, object]] = {
        "schedule": {"end_h": hours},
        "twin": {"nuisance": NUISANCE, "seed": seed},
        "clock": {"pace_h_per_s": pace},
    }
    return {
        table: {key: value for key, value in keys.items() if value is not None}
        for table, keys in options.items()
    }


def _read_process_start_s() -> float:
    """Return the Unix time in s at which this process started, so that imports count, too.

    Without ``/proc`` it is estimated from the CPU time of the process.
    """
    try:
        fields = Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        up_s = float(Path("/proc/uptime").read_text(encoding="ascii").split()[0])
        return time.time() - up_s + int(fields[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError):
        # No /proc (Windows, macOS): the interpreter's own clock started a few ms later.
        return time.time() - time.process_time()
