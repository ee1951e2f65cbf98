"""Set up instruments of any installed kind: roles, parameters and test strikes."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tomlkit
from pydantic import TypeAdapter
from tomlkit.exceptions import TOMLKitError

from daq_service.cli.doctor.check import Check
from daq_service.cli.doctor.command import run_rig_checks
from daq_service.cli.doctor.storage import lock_folder, refuse_if_owned
from daq_service.cli.doctor.trial import Trial, strike_transducer
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.drawn import prepare_shot_for_page
from daq_service.cli.set_up.init import format_head_comment, read_lab_config, validate_new_file
from daq_service.cli.set_up.transducers import Contents, Flags, make_positions_table
from daq_service.errors import RigError, UsageError
from daq_service.settings.instruments import dump_parameters, list_instruments
from daq_service.settings.tables import KeyPath, Tables
from daq_service.settings.tree import Settings
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.kinds import Role
from hardware_drivers.measurement import Waveform
from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.plug_ins import Offer, find_kind, find_offers

ROLES_OF_A_TRANSDUCER: tuple[Role, ...] = ("digitizer", "striker")
LEVEL = "trigger_level_v"
NOT_INSTRUMENTS = frozenset({"twin", "playback"})


def list_other_kinds() -> dict[str, Offer]:
    """Return the installed kinds, other than NI boards, that digitize or strike, by name."""
    excluded = NOT_INSTRUMENTS | {"daqmx"}
    return {
        name: offer
        for name, offer in find_offers().items()
        if name not in excluded and set(offer.roles) & set(ROLES_OF_A_TRANSDUCER)
    }


@dataclass(slots=True, kw_only=True, eq=False)
class Kinds:
    """Instruments of installed kinds as the dialogue sets them up; opened for one strike at a time.

    Attributes
    ----------
    parameters
        Given keys by instrument.
    wired
        Instrument of each role, by position.
    trials
        Newest strike by position.
    """

    dialogue: Dialogue
    file: Path
    data_folder: Path
    offers: Mapping[str, Offer]
    parameters: dict[str, Tables] = field(default_factory=dict)
    wired: dict[str, dict[Role, str]] = field(default_factory=dict)
    position: str | None = None
    strikes: int = 0
    trials: dict[str, Trial] = field(default_factory=dict)

    # For the page ------------------------------------------------------------------------------------

    def watch(self) -> tuple[str | None, Waveform | None]:
        """Return the position of the page and None: nothing is recorded between strikes."""
        return self.position, None

    def newest(self) -> dict[str, object]:
        """Return the newest record of the page's position for drawing; values None before a strike."""
        trial = self.trials.get(self.position or "")
        if trial is None or trial.record is None or trial.features is None:
            return {"strike": None, "shot": None}
        level_v = trial.settings.get(LEVEL)
        return {
            "strike": None,
            "level_v": level_v if isinstance(level_v, float) else None,
            **prepare_shot_for_page(trial.record, trial.features),
        }

    # For the dialogue --------------------------------------------------------------------------------

    def read_shared_values(self, flags: Flags, *, asks: bool) -> None:
        """Print the roles and parameters of each instrument if ``asks``; nothing otherwise."""
        for name, offer in self.offers.items() if asks else ():
            texts = [
                f"{key} = {schema['default']}" if "default" in schema else f"{key} (needed)"
                for key, schema in _read_parameter_schemas(name).items()
            ]
            self.dialogue.report(
                f"{name}: {' and '.join(offer.roles)}; {', '.join(texts) or 'no parameters'}"
            )

    def wire(self, position: str, text: str) -> None:
        """Wire a transducer given as ``DIGITIZER/STRIKER``, or one name for both; names are not checked."""
        digitizer, slash, striker = text.partition("/")
        self.wired[position] = {"digitizer": digitizer, "striker": striker if slash else digitizer}

    def ask_wiring(self, position: str) -> None:
        """Ask for the instruments of a transducer and for parameters until valid, and check them.

        Raises UsageError if the answers end.
        """
        self.wired[position] = {role: self._ask_instrument(position, role) for role in ROLES_OF_A_TRANSDUCER}
        self.position = position
        self._ask_parameters()
        self.check()

    def check(self) -> None:
        """Check every instrument that serves a position, and print the results; nothing strikes.

        Raises
        ------
        UsageError
            The settings so far are incomplete or invalid.
        """
        settings = self.settings()
        self._print_checks(run_rig_checks(settings, list_instruments(settings), set(), lambda what: None))

    def strike(self, position: str) -> None:
        """Strike once, print the checks, propose a trigger level, and ask for changed parameters.

        Raises BusyError if a recorder owns the data folder, UsageError if the settings are invalid or the
        answers end.
        """
        trial = self._strike_and_check(position)
        self._propose_level(position, trial)
        self._ask_parameters()

    def strike_each(self, positions: Collection[str]) -> None:
        """Strike each transducer once and print the checks; raise RigError at the first without a waveform.

        Otherwise raises as `_strike_and_check`.
        """
        for position in positions:
            if self._strike_and_check(position).record is None:
                raise RigError(f"{position} gave no record; fix what is reported above, then run it again")

    def propose_from_strikes(self, *, asks: bool) -> None:
        """Do nothing, since each strike is assessed by itself."""

    def contents(self, others: Tables, off: set[KeyPath]) -> Contents:
        """Return the values with all defaults, the switched-off tables and the head of the file.

        Raises UsageError if the values are invalid. ``others`` and ``off`` as in `Instruments.contents`.
        """
        values = self._build_file_values(others)
        for item in list_instruments(validate_new_file(values, off, self.file)):
            if item.name in self.offers:
                filled = {key: value for key, value in dump_parameters(item).items() if value is not None}
                values["rig"]["instruments"][item.name] |= filled
        struck = [name for name, trial in self.trials.items() if trial.record is not None]
        return values, off, format_head_comment(self.offers, struck)

    def result(self) -> Mapping[str, object]:
        """Return the instruments, their roles and the strikes as an object for ``--json``."""
        return {
            "instruments": {name: list(offer.distributions) for name, offer in self.offers.items()},
            "transducers": self.wired,
            "struck": [trial.as_row() for trial in self.trials.values()],
        }

    def set_parameter(self, text: str) -> None:
        """Set a parameter ``INSTRUMENT.KEY=VALUE``; without VALUE restore its default.

        The value is parsed as TOML, or is text if that fails; its range is checked later.

        Raises
        ------
        ValueError
            It is written otherwise, or there is no such instrument or key.
        """
        path, equals, value = text.partition("=")
        instrument, *keys = path.strip().split(".")
        if not equals or not keys:
            raise ValueError(
                f"{text!r} is not INSTRUMENT.KEY=VALUE, for example {next(iter(self.offers))}.KEY=1"
            )
        if instrument not in self.offers:
            raise ValueError(f"there is no {instrument}; there are: {', '.join(self.offers)}")
        if keys[0] not in (known := _read_parameter_schemas(instrument)):
            raise ValueError(f"{instrument} has no {keys[0]}; it has: {', '.join(known) or 'no parameters'}")
        table = self.parameters[instrument]
        for key in keys[:-1]:
            table = table.setdefault(key, {})
        if value.strip():
            table[keys[-1]] = _parse_toml_value(value.strip())
        else:
            table.pop(keys[-1], None)

    def settings(self) -> Settings:
        """Build the settings so far; raise UsageError that describes a missing or invalid value."""
        return validate_new_file(self._build_file_values({}), set(), self.file)

    def _build_file_values(self, others: Tables) -> Tables:
        """Build the values of the new file; `others` are further tables of [rig].

        Instruments without a position are left out.
        """
        values, _ = read_lab_config()
        rig = {name: value for name, value in values["rig"].items() if not isinstance(value, Mapping)}
        used = {name for roles in self.wired.values() for name in roles.values()}
        instruments = {
            name: {"kind": name, **given} for name, given in self.parameters.items() if name in used
        }
        rig |= {**others, "kind": "mixed", "instruments": instruments}
        rig["positions"] = {name: dict(self.wired[name]) for name in sorted(self.wired)}
        return {
            **values,
            "name": self.file.stem,
            "positions": make_positions_table(dict.fromkeys(self.wired, SOLITARY_WAVE)),
            "rig": rig,
        }

    def _strike_and_check(self, position: str) -> Trial:
        """Strike once like a normal shot, store the result, print and return it.

        Raises
        ------
        BusyError
            A recorder owns the data folder.
        UsageError
            The settings so far are invalid.
        """
        with lock_folder(self.data_folder) as owner:
            refuse_if_owned("a strike", owner)
            trial = strike_transducer(self.settings(), position, report=self.dialogue.report)
        self.position, self.trials[position] = position, trial
        self.strikes += 1
        self._print_checks(trial.checks)
        return trial

    def _ask_instrument(self, position: str, role: Role) -> str:
        """Ask which instrument has a role at a position; skip the question if only one can have it.

        Raises UsageError if the answers end.
        """
        able = [name for name, offer in self.offers.items() if role in offer.roles]
        if len(able) == 1:
            self.dialogue.report(f"{position}      {role}: {able[0]}")
            return able[0]
        text = f"The {role} of {position}"
        return self.dialogue.ask(f"{position}.{role}", text, str, default=able[0], choices=able)

    def _ask_parameters(self) -> None:
        """Ask for parameters until they are valid and no further change is requested.

        Stores them; raises UsageError if the answers end.
        """

        def parse_assignment(text: str) -> bool:
            """Set a parameter from a text; return True for "-", which ends the questions."""
            if text != "-":
                self.set_parameter(text)
            return text == "-"

        ends = good = False
        while not (ends and good):
            good = True
            try:
                self.settings()
            except UsageError as error:
                self.dialogue.report(str(error))
                good = False
            text = "A parameter to change, INSTRUMENT.KEY=VALUE" + (", - to continue" if good else "")
            ends = self.dialogue.ask("parameter", text, parse_assignment, default="-" if good else "")

    def _propose_level(self, position: str, trial: Trial) -> None:
        """Propose a tenth of the incident wave as trigger level (V), and set it if the person agrees.

        Raises UsageError if the answers end. Does nothing if the level fits or the digitizer has no such
        parameter.
        """
        digitizer = self.wired[position]["digitizer"]
        unfit = [check.values for check in trial.checks if check.state == "warn" and LEVEL in check.values]
        if not unfit or LEVEL not in _read_parameter_schemas(digitizer):
            return
        level_v, incident_v = (float(str(unfit[0][name])) for name in (LEVEL, "isw_amplitude_v"))
        proposed_v = float(f"{math.copysign(0.1 * incident_v, level_v):.2g}")
        self.dialogue.report(f"take   {digitizer}.{LEVEL} {proposed_v:g} V, a tenth of the incident wave")
        if self.dialogue.ask_yes_or_no("accept", "Take this value", default="yes"):
            self.parameters[digitizer][LEVEL] = proposed_v

    def _print_checks(self, checks: Iterable[Check]) -> None:
        """Print state, name, finding and remedy of each check."""
        for check in checks:
            remedy = f"; {check.remedy}" if check.remedy else ""
            self.dialogue.report(f"{check.state:<6} {check.name}: {check.found}{remedy}")


def build_named_kinds(
    dialogue: Dialogue, names: Sequence[str], assignments: Sequence[str], file: Path, folder: Path
) -> Kinds:
    """Build the named instruments with parameters given as ``INSTRUMENT.KEY=VALUE``.

    ``file`` is the new configuration, ``folder`` the test's data folder.

    Raises
    ------
    UsageError
        One is not installed, or neither digitizes nor strikes; nothing digitizes, or nothing strikes; or a
        parameter does not exist.
    """
    available = list_other_kinds()
    try:
        for name in names:
            find_kind(name)
    except ConfigurationError as error:
        raise UsageError(f"--kind: {error}") from error
    if idle := sorted(set(names) - set(available)):
        raise UsageError(
            f"--kind: {', '.join(idle)} neither digitizes nor strikes here; NI boards are set up without "
            f"--kind, and others are: {', '.join(available) or 'none installed'}"
        )
    for role in ROLES_OF_A_TRANSDUCER:
        if not any(role in available[name].roles for name in names):
            able = ", ".join(name for name, offer in available.items() if role in offer.roles)
            raise UsageError(
                f"--kind: none of {', '.join(names)} is a {role}; add one that is: "
                f"{able or 'none is installed (docs/how-to/write-a-driver.md)'}"
            )
    kinds = Kinds(
        dialogue=dialogue,
        file=file,
        data_folder=folder,
        offers={name: available[name] for name in names},
        parameters={name: {} for name in names},
    )
    try:
        for assignment in assignments:
            kinds.set_parameter(assignment)
    except ValueError as error:
        raise UsageError(f"--set: {error}") from error
    return kinds


def _read_parameter_schemas(instrument: str) -> Tables:
    """Return the parameters of an installed kind as JSON Schema by name; empty if it has none.

    Raises ConfigurationError if the kind is not installed.
    """
    kind, _ = find_kind(instrument)
    properties: Tables = TypeAdapter[object](kind.parameters).json_schema().get("properties", {})
    return properties


def _parse_toml_value(text: str) -> object:
    """Parse a number, a truth value, a list or a table as TOML; return other text unchanged."""
    try:
        return tomlkit.value(text).unwrap()
    except TOMLKitError:
        return text
