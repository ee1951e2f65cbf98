"""Transducers of a set-up: wiring, recorded waveforms, and the proposed settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from analysis.errors import AnalysisError
from analysis.waves.coil_spike import HOLDOFF_DIGITS, HOLDOFF_PART
from analysis.waves.features import extract_features
from analysis.waves.first_settings import Proposal, StruckTransducer, cut_triggered_record, propose_settings
from daq_service.cli.doctor.storage import lock_folder, refuse_if_owned
from daq_service.cli.set_up.drawn import compute_envelope, prepare_shot_for_page
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring, fall_s
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.measurement import Waveform

if TYPE_CHECKING:
    from hardware_drivers.daqmx.pulse_record import FreeInput
    from hardware_drivers.daqmx.survey import BoardFacts

T = TypeVar("T")

PAPER_RATE_HZ = 10e6
FIRST_RANGE_V = 10.0
"""A first look is taken in the largest range up to this one: it clips little, and wastes few codes."""
READ_TIMEOUT_S = 30.0
"""Longest wait for a record of a whole strike, which takes tenths of a second, over a slow network too."""


@dataclass(slots=True, kw_only=True, eq=False)
class Bench:
    """Wired transducers; one thread of its own uses the boards.

    Attributes
    ----------
    data_folder
        The test's: nothing strikes while a recorder owns it.
    transducers
        Wiring by position.
    position
        The transducer that was wired last: the one that the page looks at.
    strikes
        Records of a whole strike so far.
    holds_off
        False once a coil's counter could not start its acquisition.
    quiet, struck
        Newest record at rest, and of a whole strike, by position.
    """

    boards: Mapping[str, BoardFacts]
    data_folder: Path
    transport: Literal["library", "grpc"] = "library"
    grpc_address: str = ""
    drop_height_m: float = 5e-3
    pulse_s: float = 0.1
    chosen: Proposal | None = None
    transducers: dict[str, TransducerWiring] = field(default_factory=dict)
    position: str | None = None
    strikes: int = 0
    holds_off: bool = True
    quiet: dict[str, Waveform] = field(default_factory=dict)
    struck: dict[str, Waveform] = field(default_factory=dict)
    _free: FreeInput | None = None
    _thread: ThreadPoolExecutor = field(
        default_factory=lambda: ThreadPoolExecutor(max_workers=1, thread_name_prefix="boards")
    )

    def wire(self, position: str, wiring: TransducerWiring) -> Waveform:
        """Add a transducer in the widest input range up to `FIRST_RANGE_V`, and record its input at rest.

        On an error the transducers are as before, and none is current. If all ranges are wider, the narrowest
        is used.

        Raises
        ------
        ValueError
            It shares an input, counter or terminal with another one, or a value is invalid.
        InstrumentError
            The boards refuse.
        """
        ranges_v = self.ranges_v(wiring)
        wide_v = max((one for one in ranges_v if one <= FIRST_RANGE_V), default=min(ranges_v))
        before, self.position = dict(self.transducers), None
        self.transducers[position] = replace(wiring, range_v=wide_v)
        self.struck.pop(position, None)
        try:
            self.parameters()
            record = self.look(position)
        except BaseException:
            self.transducers = before
            raise
        self.position = position
        return record

    def look(self, position: str) -> Waveform:
        """Record the input of a transducer at rest, store and return the record; raise as `wire`."""
        self.quiet[position] = record = self._run_on_boards(position, lambda free: free.record_quiet_input())
        return record

    def watch(self) -> tuple[str | None, Waveform | None]:
        """Record the current input at rest for the page; the stored records do not change.

        Returns position and record, or (None, None) before a transducer is wired.

        Raises
        ------
        InstrumentError
            As for `wire`.
        """
        position = self.position
        if position is None:
            return None, None
        return position, self._run_on_boards(position, lambda free: free.record_quiet_input())

    def strike(self, position: str) -> None:
        """Strike once and store the complete record; blocks up to `READ_TIMEOUT_S`.

        Raises
        ------
        BusyError
            A recorder owns the data folder.
        ConfigurationError
            The coil's counter cannot start the acquisition: neither a holdoff nor this record is
            possible; ``holds_off`` is set to False.
        InstrumentError
            The boards fail otherwise.
        """
        with lock_folder(self.data_folder) as owner:
            refuse_if_owned("a strike", owner)
            try:
                self.struck[position] = self._run_on_boards(position, lambda free: free.strike())
            except ConfigurationError:
                # It could be looked at, so what the boards refuse is that the coil's counter starts them.
                self.holds_off = False
                raise
            self.strikes += 1

    def change_range(self, position: str, range_v: float) -> None:
        """Set another input range in V for a transducer and record its input at rest; raise as `wire`.

        After an error the new range stays.
        """
        self.transducers[position] = replace(self.transducers[position], range_v=range_v)
        self.look(position)

    def propose_values(self) -> Proposal | None:
        """Assess all strikes so far and return the proposed values; None before the first strike.

        Uses the newest record at rest and of a strike of each transducer.

        Raises
        ------
        RecordError
            A record ends before a wave could have come.
        """
        if not self.struck:
            return None
        known = {
            name: StruckTransducer(
                noise=self.quiet[name], strike=strike, ranges_v=self.ranges_v(self.transducers[name])
            )
            for name, strike in self.struck.items()
        }
        return propose_settings(known, pulse_s=self.pulse_s, fall_s=fall_s(self.drop_height_m))

    def newest(self) -> dict[str, object]:
        """Return the newest strike for the page, and the shot that the proposed values would cut from it.

        Both None before a strike; the shot None without a trigger level or trigger; ``error`` has an analysis
        error.
        """
        position, strike = self.position, self.struck.get(self.position or "")
        if position is None or strike is None:
            return {"strike": None, "shot": None}
        answer: dict[str, object] = {"strike": compute_envelope(strike), "shot": None, "off_s": self.pulse_s}
        try:
            proposal = self.propose_values()
        except AnalysisError as error:
            return answer | {"error": str(error)}
        assert proposal is not None, "it was struck"
        level_v, holdoff_s = proposal.trigger_level_v, proposal.holdoff_s or 0.0
        answer |= {"level_v": level_v, "holdoff_s": holdoff_s, "proposed_range_v": proposal.range_v[position]}
        if level_v is None:
            return answer
        shot = cut_triggered_record(
            strike,
            after_s=self.pulse_s + holdoff_s,
            level_v=level_v,
            rising=proposal.rising,
            pretrigger_samples=round(proposal.pretrigger_s * strike.sample_rate_hz),
            samples=self.parameters(position).record_samples,
        )
        if shot is None:
            return answer
        return answer | prepare_shot_for_page(shot, extract_features(shot), rising=proposal.rising)

    def ranges_v(self, wiring: TransducerWiring) -> list[float]:
        """List the symmetric input ranges -r .. +r of the transducer's board as r in V, rising."""
        board = self.boards[wiring.board_serial]
        return sorted(high for low, high in board.ranges_v if math.isclose(-low, high))

    def parameters(self, position: str | None = None) -> DaqmxParameters:
        """Build the driver's parameters with the chosen values, of all transducers or of one.

        Those of one position ignore the chosen values. Raises ValueError if values do not go together.
        """
        wirings = self.transducers if position is None else {position: self.transducers[position]}
        rate_hz = min(
            PAPER_RATE_HZ, *(self.boards[wiring.board_serial].max_rate_hz for wiring in wirings.values())
        )
        usual = DaqmxParameters(transducers={"": TransducerWiring(board_serial="0")})
        after = round((usual.record_samples - usual.pretrigger_samples) / PAPER_RATE_HZ * rate_hz)
        pretrigger_s = usual.pretrigger_samples / PAPER_RATE_HZ
        level_v = min(usual.trigger_level_v, 0.5 * min(wiring.range_v for wiring in wirings.values()))
        slope, holdoff_s, ringing_s = usual.trigger_slope, usual.holdoff_s, usual.ringing_s
        if position is None and self.chosen is not None:
            chosen = self.chosen
            pretrigger_s, level_v = chosen.pretrigger_s, chosen.trigger_level_v or level_v
            slope = "rising" if chosen.rising else "falling"
            # One holdoff for all: none where one of them cannot have it.
            holdoff_s, ringing_s = (chosen.holdoff_s, chosen.ringing_s) if self.holds_off else (None, 0.0)
        elif position is None and self.holds_off:
            # Nothing was struck: the holdoff of a coil that does not ring.
            holdoff_s = round(HOLDOFF_PART * (fall_s(self.drop_height_m) - pretrigger_s), HOLDOFF_DIGITS)
        pretrigger = round(pretrigger_s * rate_hz)
        return DaqmxParameters(
            transducers=wirings,
            transport=self.transport,
            grpc_address=self.grpc_address,
            sample_rate_hz=rate_hz,
            record_samples=pretrigger + after,
            pretrigger_samples=pretrigger,
            pulse_s=self.pulse_s,
            drop_height_m=self.drop_height_m,
            trigger_level_v=level_v,
            trigger_slope=slope,
            holdoff_s=holdoff_s,
            ringing_s=ringing_s,
        )

    def accept_proposal(self, proposal: Proposal) -> None:
        """Store a proposal, with or without a person's changes, and set its input ranges.

        Raises
        ------
        ValueError
            Its values do not go together; nothing is changed.
        """
        before = dict(self.transducers), self.chosen
        for name, range_v in proposal.range_v.items():
            self.transducers[name] = replace(self.transducers[name], range_v=range_v)
        self.chosen = proposal
        try:
            self.parameters()
        except ValueError:
            self.transducers, self.chosen = before
            raise

    def table(self) -> dict[str, object]:
        """Build the table [rig.daqmx] of the configuration file, without keys that are None."""
        return {name: value for name, value in asdict(self.parameters()).items() if value is not None}

    def close(self) -> None:
        """Close the open input, release the boards and end their thread; waits for running work."""
        self._thread.submit(self._close_input).result()
        self._thread.shutdown()

    def _run_on_boards(self, position: str, work: Callable[[FreeInput], T]) -> T:
        """Run work in the thread of the boards, wait for it, and return its result or raise its error."""
        return self._thread.submit(self._run_with_input, position, self.parameters(position), work).result()

    def _run_with_input(
        self, position: str, parameters: DaqmxParameters, work: Callable[[FreeInput], T]
    ) -> T:
        """Run work with the input of a position, opened again if position or parameters changed.

        After an error the input is closed.
        """
        from hardware_drivers.daqmx.pulse_record import FreeInput

        if self._free is None or (self._free.position, self._free.parameters) != (position, parameters):
            self._close_input()
            self._free = FreeInput(parameters, position, READ_TIMEOUT_S)
        try:
            return work(self._free)
        except BaseException:
            self._close_input()
            raise

    def _close_input(self) -> None:
        """Close the open input; nothing if none is open."""
        free, self._free = self._free, None
        if free is not None:
            free.close()


def compute_noise_rms_v(record: Waveform) -> float:
    """Compute the noise of a record in V rms about its mean, hum included."""
    return float(np.std(record.volts()))
