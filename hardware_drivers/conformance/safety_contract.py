"""Rules for interruptions and failures of an instrument: `SafetyContract`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress

import pytest

from hardware_drivers.conformance.bench import Bench
from hardware_drivers.conformance.kind_contract import Open
from hardware_drivers.errors import AcquisitionTimeoutError, InstrumentError
from hardware_drivers.kinds import Opened, Opening, Role
from hardware_drivers.measurement import ShotKey

TIMEOUT_S = 0.05
"""What a fault swallows is not waited for."""
WHOLE_TIMEOUT_S = 30.0
"""Of an instrument that is well again: reached on a machine that hangs, not on one that is busy."""
AT_REST = ("arm", "disarm", "make_safe", "measure")
"""Calls that an instrument must take although no one strikes."""
Call = Callable[[], object]


class SafetyContract:
    """Rules for failures: errors are solimon's own.

    Then nothing is armed, every coil is off, it opens again.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    bench : Bench
        The bench that injects faults and records what the coils did.
    opening : Opening
        The opening of the instrument under test.
    open_kind : Open
        A function that opens the instrument.
    fault : str
        The name of the fault to inject.
    """

    def test_it_is_safe_after_an_interruption(self, bench: Bench, open_kind: Open, opening: Opening) -> None:
        """Check that every coil is off after an armed and struck instrument is closed.

        Then it opens and arms again.
        """
        with open_kind() as opened:
            for _, call in _list_calls(opened, opening, ("arm", "strike"), WHOLE_TIMEOUT_S):
                call()
        assert _find_energised_coils(bench) == []
        with open_kind() as opened:
            for _, call in _list_calls(opened, opening, ("arm",)):
                call()

    def test_opening_fails_by_errors_of_hardware_drivers_only(
        self, bench: Bench, open_kind: Open, fault: str
    ) -> None:
        """Check that opening a faulty instrument succeeds or raises `InstrumentError`, and nothing else."""

        def open_it() -> None:
            """Open the instrument and close it at once; whether that fails is up to the fault."""
            with open_kind():
                """Opened all the same: a fault that only calls will tell."""

        with _inject_fault(bench, fault):
            _capture_error("opening", open_it)

    def test_calls_fail_by_errors_of_hardware_drivers_only(
        self, bench: Bench, open_kind: Open, opening: Opening, fault: str
    ) -> None:
        """Check that calls of a faulty instrument raise `InstrumentError` only, and at least one does."""
        errors = {}
        with _open_faulty_instrument(open_kind) as opened, _inject_fault(bench, fault):
            for name, call in _list_calls(opened, opening):
                errors[name] = _capture_error(name, call)
        assert any(errors.values()), (
            f"no call reported the fault {fault!r}: {', '.join(errors) or 'none was made'}"
        )

    def test_after_an_error_nothing_is_armed(
        self, bench: Bench, open_kind: Open, opening: Opening, fault: str
    ) -> None:
        """Check that a failed read disarms: a second read raises another error than AcquisitionTimeoutError.

        Skipped for an instrument that is no digitizer.
        """
        with _open_faulty_instrument(open_kind) as opened:
            if opened.digitizer is None or "digitizer" not in opening.serves:
                pytest.skip("it is no digitizer")
            opened.digitizer.arm(_make_shot_key("digitizer", opening))
            read = opened.digitizer.read
            with _inject_fault(bench, fault):
                first = _capture_error("read", lambda: read(TIMEOUT_S))
            assert first is not None, f"read did not report the fault {fault!r}"
            second = _capture_error("read", lambda: read(TIMEOUT_S))
            assert second is not None, "there was nothing to read any more"
            assert not isinstance(second, AcquisitionTimeoutError), "it waited again: still armed"

    def test_after_an_error_every_coil_is_off(
        self, bench: Bench, open_kind: Open, opening: Opening, fault: str
    ) -> None:
        """Check that every coil is off after each strike and `make_safe` of a faulty instrument.

        Skipped if the bench does not report the coils.
        """
        if bench.coil_levels is None:
            pytest.skip("it has no coil, or what its coils did is unknown")
        with _open_faulty_instrument(open_kind) as opened, _inject_fault(bench, fault):
            for name, call in _list_calls(opened, opening, ("strike", "make_safe")):
                _capture_error(name, call)
                assert _find_energised_coils(bench) == [], f"after {name}"
        assert _find_energised_coils(bench) == []

    def test_after_a_fault_it_can_be_opened_again(
        self, bench: Bench, open_kind: Open, opening: Opening, fault: str
    ) -> None:
        """Check that an instrument closed while faulty can be opened again after the fault.

        Every call that needs no strike then succeeds.
        """
        with ExitStack() as still, _open_faulty_instrument(open_kind) as opened:
            # Ended last: the instrument is left while it fails.
            still.enter_context(_inject_fault(bench, fault))
            for name, call in _list_calls(opened, opening):
                _capture_error(name, call)
        with open_kind() as opened:
            for _, call in _list_calls(opened, opening, AT_REST, WHOLE_TIMEOUT_S):
                call()


@contextmanager
def _open_faulty_instrument(open_kind: Open) -> Iterator[Opened]:
    """Open an instrument, yield it, and close it; an `InstrumentError` of the closing is suppressed.

    Errors of the opening and of the block pass through.
    """
    with ExitStack() as stack:
        yield stack.enter_context(open_kind())
        with suppress(InstrumentError):
            stack.close()


def _inject_fault(bench: Bench, fault: str) -> AbstractContextManager[object]:
    """Return the context manager that injects a fault; AssertionError if the bench cannot inject any."""
    assert bench.fault is not None, "a double that names faults gives Bench.fault"
    return bench.fault(fault)


def _capture_error(name: str, call: Call) -> InstrumentError | None:
    """Call a function and return its `InstrumentError`, None if it succeeds.

    Raise AssertionError, with the name of the call, for any other exception.
    """
    try:
        call()
    except InstrumentError as error:
        return error
    except Exception as error:
        raise AssertionError(
            f"{name} raised {type(error).__name__}: {error}; raise an InstrumentError"
        ) from error
    return None


def _make_shot_key(role: Role, opening: Opening) -> ShotKey:
    """Return the key of shot 0 of set 0 at the first position that the instrument serves in a role.

    KeyError or IndexError if it serves none.
    """
    return ShotKey(position=opening.serves[role][0], set_index=0, shot_index=0)


def _list_calls(
    opened: Opened, opening: Opening, only: tuple[str, ...] = (), timeout_s: float = TIMEOUT_S
) -> Iterator[tuple[str, Call]]:
    """Return an iterator over the calls of every served role with their names; no call is made here.

    They come in the order arm, strike, read, disarm, make safe, measure.

    Parameters
    ----------
    only
        Names of the calls wanted; empty: all.
    """
    calls_by_role: dict[str, list[Call]] = {
        name: [] for name in ("arm", "strike", "read", "disarm", "make_safe", "measure")
    }
    if (digitizer := opened.digitizer) is not None and "digitizer" in opening.serves:
        calls_by_role["arm"].append(lambda: digitizer.arm(_make_shot_key("digitizer", opening)))
        calls_by_role["read"].append(lambda: digitizer.read(timeout_s))
        calls_by_role["disarm"].append(digitizer.disarm)
    if (striker := opened.striker) is not None and "striker" in opening.serves:
        calls_by_role["strike"].append(lambda: striker.strike(_make_shot_key("striker", opening)))
        calls_by_role["make_safe"].append(striker.make_safe)
    if (pulse_echo := opened.pulse_echo) is not None and "pulse_echo" in opening.serves:
        calls_by_role["strike"].append(
            lambda: pulse_echo.acquire(_make_shot_key("pulse_echo", opening), timeout_s)
        )
    if (supply := opened.supply) is not None and "supply" in opening.serves:
        calls_by_role["measure"].append(lambda: supply.read(timeout_s))
        calls_by_role["make_safe"].append(supply.make_safe)
    if (climate := opened.climate) is not None and "climate" in opening.serves:
        calls_by_role["measure"].append(lambda: climate.read(timeout_s))
    return (
        (name, call)
        for name, calls in calls_by_role.items()
        if name in (only or calls_by_role)
        for call in calls
    )


def _find_energised_coils(bench: Bench) -> list[str]:
    """Return the positions whose coil is on after all switchings so far; empty if the bench reports none."""
    levels: Mapping[str, bool] = dict(bench.coil_levels()) if bench.coil_levels is not None else {}
    return [position for position, on in levels.items() if on]
