"""The twin's physics in a process of its own, beside the recorder's line.

Threads would share the interpreter's lock: the extraction of features hands it over at every array, and
each handing over costs as much as what is computed. Here a worker process builds the same specimen from the
same settings and computes records by their key; the recorder strikes, reads and stores as ever. The worker
holds nothing that could be lost: where it dies, the recorder computes its records itself.

The simulator is imported where it is needed: the worker starts while the recorder imports its own.
"""

from __future__ import annotations

import atexit
import multiprocessing
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from importlib.metadata import version
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from daq_service.acquisition.schedule import plan_sets
from daq_service.acquisition.strikes_ahead import build_strike_predictor
from daq_service.errors import UsageError
from daq_service.processes.installation import MODULES, require_extras
from daq_service.processes.worker import leave_with_parent, start_one_worker
from daq_service.settings.tree import Settings
from hardware_drivers.bounds import bounded
from hardware_drivers.instruments import Acquired
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, Role
from hardware_drivers.measurement import ShotKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE

if TYPE_CHECKING:
    from simulator.specimen import Specimen, Transducer


STRIKES_WORTH_A_PROCESS = 2_000
"""From so many on a process of its own for the twin saves more time than it takes to start."""

COMPILING = "compiling the twin's loops, once on this computer"
BUILDING = "building the twin's plates, which are kept for the next time"


def build_transducers(settings: Settings) -> dict[str, Transducer]:
    """Build the bead chain and the physical model of each solitary-wave position, by position.

    Raises
    ------
    SimulatorError
        A transducer cannot be built as configured.
    """
    from simulator.experiment.corrosion import make_patch
    from simulator.shot.model import ShotModel
    from simulator.specimen import Transducer

    places = settings.positions
    return {
        name: Transducer(
            chain=places[name].chain,
            model=ShotModel(
                places[name].chain,
                places[name].plate,
                make_patch(settings.twin, name, places[name].corrosion),
            ),
        )
        for name in settings.list_positions(SOLITARY_WAVE)
    }


def start_twin_executor(settings: Settings, sender: Connection | None = None) -> ProcessPoolExecutor:
    """Start a worker process that builds the specimen and then runs `compute_records`.

    Returns at once; the caller shuts it down. If the process dies, its tasks raise BrokenExecutor.

    Parameters
    ----------
    sender
        Pipe to which it sends the start (True) and the end (False) of a compilation.
    """
    return start_one_worker(_prepare_specimen, settings.model_dump_json(), sender)


@contextmanager
def run_twin_process(settings: Settings, compiling: Callable[[bool], None]) -> Iterator[ProcessPoolExecutor]:
    """Start the twin's worker process, yield its executor, and shut it down on exit.

    Pending work is canceled on exit. A thread calls ``compiling`` with True at the start and False at the end
    of each compilation.
    """
    receiver, sender = multiprocessing.get_context("spawn").Pipe(duplex=False)
    with receiver:
        with sender:  # once it has started, it alone holds this end: the pipe ends with it
            executor = start_twin_executor(settings, sender)
        listening = threading.Thread(
            target=_forward_messages, args=(receiver, compiling), name="news-of-the-worker", daemon=True
        )
        listening.start()
        try:
            yield executor
        finally:
            executor.shutdown(cancel_futures=True)
            listening.join()


def _forward_messages(receiver: Connection, compiling: Callable[[bool], None]) -> None:
    """Call ``compiling`` with each state (True: it compiles) that the worker sends, until its pipe closes.

    If the worker ends during a compilation, ``compiling(False)`` is called last.
    """
    is_compiling = False
    with suppress(EOFError, OSError):  # the worker has ended, or was killed in the midst of a word
        while True:
            is_compiling = receiver.recv()
            compiling(is_compiling)
    if is_compiling:
        compiling(False)


def compute_records(settings_json: str, strikes: Sequence[tuple[ShotKey, float]]) -> list[Acquired | None]:
    """Simulate the records of strikes (key and test hour), with their features, in the worker process.

    In the order of the strikes; None for a strike that misses the chain. If the extraction of features fails,
    all records come without features.
    """
    from daq_service.acquisition.shot_features import extract_record_features

    return extract_record_features(_build_specimen(settings_json).simulate_waves(strikes))


@cache
def _build_specimen(settings_json: str) -> Specimen:
    """Build the simulated specimen from the settings as JSON; cached for each text in this process."""
    from simulator.specimen import build_specimen

    settings = Settings.model_validate_json(settings_json)
    return build_specimen(
        settings.twin,
        transducers=build_transducers(settings),
        probed_thickness_m={
            name: settings.positions[name].plate.thickness_m for name in settings.list_positions(PULSE_ECHO)
        },
    )


def _prepare_specimen(settings_json: str, sender: Connection | None) -> None:
    """Initialize the worker: end with the parent, send the states of compilations, build the specimen.

    Without ``sender`` compilations are not reported.
    """
    leave_with_parent()
    import daq_service.acquisition.shot_features  # noqa: F401 - while the recorder opens the test

    if sender is not None:
        from simulator.numerics.machine_code import report_compilation

        reporting = ExitStack()
        reporting.enter_context(report_compilation(sender.send))
        atexit.register(reporting.close)  # kept as long as the process
    _build_specimen(settings_json)


# As a kind of instrument -------------------------------------------------------------------------------


@bounded
class TwinOfTheExperiment:
    """No keys: [chain], [plate], [corrosion] and [twin] describe the twin."""


@contextmanager
def _open_twin(parameters: TwinOfTheExperiment, opening: Opening) -> Iterator[Opened]:
    """Open the twin as an instrument; unpaced tests of 2000 strikes or more compute it in another process.

    Others compute it in a thread. On exit pending work is canceled. Raises UsageError if the specimen cannot
    be built as configured.
    """
    require_extras("twin")
    settings = Settings.model_validate(opening.experiment)
    places, schedule, serves = settings.positions, settings.schedule, opening.serves
    served = {name: places[name] for name in opening.positions}
    sets = plan_sets(schedule.phases, opening.epoch_utc_ns, end_h=schedule.end_h)
    planned = build_strike_predictor(
        sets,
        settings.list_positions(SOLITARY_WAVE),
        shots_per_set=schedule.shots_per_set,
        shot_interval_s=schedule.shot_interval_s,
    )
    settings = settings.model_copy(update={"positions": served})
    compiling = partial(opening.preparing, COMPILING)
    own_process = _needs_own_process(settings, len(sets))
    with ExitStack() as stack:
        # One worker: the physics of the next shots runs while this one is stored and judged.
        executor: Executor = (
            stack.enter_context(run_twin_process(settings, compiling))
            if own_process
            else ThreadPoolExecutor(max_workers=1, thread_name_prefix="twin")
        )
        stack.callback(executor.shutdown, cancel_futures=True)
        # These imports take a while: the worker has started by now.
        from simulator.errors import SimulatorError
        from simulator.instruments import build_bench
        from simulator.numerics.machine_code import report_compilation

        stack.enter_context(report_compilation(compiling))
        opening.preparing(BUILDING, True)
        try:
            transducers = build_transducers(settings)
        except SimulatorError as error:
            raise UsageError(f"the twin cannot be built as configured: {error}") from error
        finally:
            opening.preparing(BUILDING, False)
        bench = build_bench(
            settings.twin,
            clock=opening.clock,
            epoch_utc_ns=opening.epoch_utc_ns,
            transducers=transducers,
            probed_thickness_m={
                name: places[name].plate.thickness_m for name in serves.get("pulse_echo", ())
            },
            strikes_after=lambda key, utc_ns: (
                strike for strike in planned(key, utc_ns) if strike[0].position in served
            ),
            executor=executor,
            compute=partial(compute_records, settings.model_dump_json()) if own_process else None,
        )
        yield Opened(
            striker=bench.striker,
            digitizer=bench.digitizer,
            pulse_echo=bench.pulse_echo,
            identity={"twin": version("solimon"), "seed": str(settings.twin.seed)},
        )


def _needs_own_process(settings: Settings, n_sets: int) -> bool:
    """Return whether the test is unpaced and has at least `STRIKES_WORTH_A_PROCESS` (2000) planned strikes.

    Below that, starting a process (a second or two) takes longer than it saves.
    """
    unpaced = settings.clock.kind == "simulated" and settings.clock.pace_h_per_s is None
    strikes = n_sets * settings.schedule.shots_per_set * len(settings.list_positions(SOLITARY_WAVE))
    return unpaced and strikes >= STRIKES_WORTH_A_PROCESS


def _check_boards(parameters: TwinOfTheExperiment, opening: Opening) -> Iterator[Finding]:
    """Yield the only finding of the twin: state ``ok``, because there are no boards to check."""
    yield Finding(subject="rig", check="", state="ok", detail="simulated: no boards to look at")


def _require_both_roles(parameters: TwinOfTheExperiment, serves: Mapping[Role, tuple[str, ...]]) -> None:
    """Raise ValueError for the first position that the twin only strikes or only digitizes."""
    struck, digitized = (set(serves.get(role, ())) for role in ("striker", "digitizer"))
    if apart := sorted(struck ^ digitized):
        raise ValueError(
            f"the twin strikes and digitizes in one: at {apart[0]!r} it does only one of both; name it as "
            f"digitizer and striker in [rig.positions.{apart[0]}]"
        )


KIND = Kind(
    parameters=TwinOfTheExperiment,
    open=_open_twin,
    check=_check_boards,
    require=_require_both_roles,
    packages=lambda parameters: MODULES["twin"],
)
