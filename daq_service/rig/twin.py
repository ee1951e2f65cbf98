"""The twin's physics in a process of its own, beside the recorder's line.

Threads would share the interpreter's lock: the extraction of features hands it over at every array, and
each handing over costs as much as what is computed. Here a worker process builds the same specimen from the
same settings and computes records by their key; the recorder strikes, reads and stores as ever. The worker
holds nothing that could be lost: where it dies, the recorder computes its records itself.

The simulator is imported where it is needed: the worker starts while the recorder imports its own.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from daq_service.acquisition.schedule import plan_sets
from daq_service.acquisition.strikes_ahead import build_strike_predictor
from daq_service.errors import UsageError
from daq_service.processes.installation import MODULES, require_extras
from daq_service.processes.worker import leave_with_parent, start_one_worker
from daq_service.settings.instruments import list_instruments
from daq_service.settings.tree import Settings
from hardware_drivers.bounds import bounded
from hardware_drivers.instruments import Acquired
from hardware_drivers.kinds import Finding, Kind, Opened, Opening, Role
from hardware_drivers.measurement import ShotKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE

if TYPE_CHECKING:
    from analysis.waves.record_reduction import ExtractionSettings
    from simulator.specimen import Specimen, Transducer


STRIKES_WORTH_A_PROCESS = 2_000
"""From so many on a process of its own for the twin saves more time than it takes to start."""

PREPARING = "preparing the twin's plates and machine code, once on this computer"


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


def start_twin_executor() -> ProcessPoolExecutor:
    """Start a worker process that runs `compute_records`, and return at once; the caller shuts it down.

    If the process dies, its tasks raise BrokenExecutor.
    """
    return start_one_worker(_prepare_worker)


def prepare_twin(
    settings: Settings, worker: Executor | None, preparing: Callable[[str, bool], None]
) -> dict[str, Transducer]:
    """Build the transducers and compile the loops of the twin at the same time; return the transducers.

    ``preparing`` is called each second, as `Opening.preparing`.

    Parameters
    ----------
    worker
        Process that compiles its part; None starts one if this computer has no machine code yet.

    Raises
    ------
    SimulatorError
        A transducer cannot be built as configured.
    """
    from simulator.compile_loops import compile_other_loops, compile_wide_loop
    from simulator.numerics.machine_code import call_at_first_compilation

    laws = {settings.positions[name].chain.damping_law for name in settings.list_positions(SOLITARY_WAVE)}
    elsewhere: list[Future[None]] = []

    def compile_wide_loops() -> None:
        """Compile the loops of many strikes, and start the process for the others if that takes long."""
        with call_at_first_compilation(start_worker):
            for law in laws:
                compile_wide_loop(law)

    def start_worker() -> None:
        """Compile the other loops in the caller's process or a new one; stop garbage collection here.

        It would take a fifth of the time: millions of objects live until a loop is compiled.
        """
        gc.disable()
        compiling = worker or stack.enter_context(start_one_worker(_prepare_compiler))
        elsewhere.extend(compiling.submit(compile_other_loops, law) for law in laws)

    def compile_others() -> None:
        """Load the loops that the other process has compiled, and compile what it has not."""
        wait([wide])
        wait(elsewhere)
        for law in laws:
            compile_other_loops(law)

    started_s = time.monotonic()
    with ExitStack() as stack, ThreadPoolExecutor(max_workers=3, thread_name_prefix="twin") as pool:
        stack.callback(gc.enable)
        wide = pool.submit(compile_wide_loops)
        transducers = pool.submit(build_transducers, settings)
        parts: list[Future[Any]] = [wide, transducers, pool.submit(compile_others)]
        while pending := [part for part in parts if not part.done()]:
            done, took_s = len(parts) - len(pending), time.monotonic() - started_s
            preparing(f"{PREPARING}: part {done + 1} of {len(parts)}, {took_s:.0f} s", True)
            wait(pending, 1.0, FIRST_COMPLETED)
        preparing(PREPARING, False)
        for part in parts:
            part.result()
    return transducers.result()


def compute_records(settings_json: str, strikes: Sequence[tuple[ShotKey, float]]) -> list[Acquired | None]:
    """Simulate the records of strikes (key and test hour), with their features, in the worker process.

    In the order of the strikes; None for a strike that misses the chain. If the extraction of features fails,
    all records come without features.
    """
    from daq_service.acquisition.shot_features import extract_record_features

    records = _build_specimen(settings_json).simulate_waves(strikes)
    positions = [key.position for key, _ in strikes]
    return extract_record_features(records, positions, _extraction_settings(settings_json))


@cache
def _extraction_settings(settings_json: str) -> Mapping[str, ExtractionSettings]:
    """Derive how features are extracted at each position from the settings as JSON; cached for each text."""
    from daq_service.acquisition.shot_features import derive_extraction_settings

    return derive_extraction_settings(Settings.model_validate_json(settings_json).positions)


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


def _build_specimen_ahead(settings_json: str) -> None:
    """Build the specimen in the worker process before the first strike."""
    _build_specimen(settings_json)


def _prepare_worker() -> None:
    """Initialize the twin's worker process: end with the parent, import while the recorder opens the test."""
    leave_with_parent()
    import daq_service.acquisition.shot_features  # noqa: F401


def _prepare_compiler() -> None:
    """Initialize the process that compiles: end with the parent, collect no garbage."""
    leave_with_parent()
    gc.disable()


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
    own_process = _needs_own_process(settings, len(sets))
    with ExitStack() as stack:
        # One worker: the physics of the next shots runs while this one is stored and judged.
        worker = start_twin_executor() if own_process else None
        executor: Executor = worker or ThreadPoolExecutor(max_workers=1, thread_name_prefix="twin")
        stack.callback(executor.shutdown, cancel_futures=True)
        # These imports take a while: the worker has started by now.
        from simulator.errors import SimulatorError
        from simulator.instruments import build_bench

        try:
            transducers = prepare_twin(settings, worker, opening.preparing)
        except SimulatorError as error:
            raise UsageError(f"the twin cannot be built as configured: {error}") from error
        if worker is not None:
            worker.submit(_build_specimen_ahead, settings.model_dump_json())
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
    yield Finding(subject="rig", check="", state="ok", detail="simulated: no boards to check")


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


def require_twin(settings: Settings) -> None:
    """Raise MissingExtraError if an instrument is the twin and its packages are not installed."""
    if any(item.kind is KIND for item in list_instruments(settings)):
        require_extras("twin")
