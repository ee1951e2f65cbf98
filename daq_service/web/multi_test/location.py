"""Location of a test, and the reason why it cannot be shown; read again for each request."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from daq_service.catalogue.errors import CatalogueDamagedError, NoDataYetError, SchemaVersionError
from daq_service.catalogue.experiment_file import read_experiment_file
from daq_service.catalogue.rows import ExperimentRow
from daq_service.catalogue.store import open_catalogue
from daq_service.errors import SolimonError, UsageError
from daq_service.processes.data_folder import load_settings_and_folder, require_data_folder
from daq_service.settings.stored import restore_settings
from daq_service.settings.tree import Settings
from daq_service.shared_file import load_module_toml
from daq_service.web.auth.middleware import AccessPolicy
from daq_service.web.auth.tokens import find_tokens_file, read_tokens

Absence = Literal[
    "no_data", "missing", "foreign", "misconfigured", "damaged", "other_version", "locked", "unreadable"
]

REMEDIES = TypeAdapter(dict[Absence, str]).validate_python(load_module_toml(__file__))


class AbsentError(SolimonError):
    """A test cannot be shown now."""

    def __init__(self, state: Absence, message: str) -> None:
        super().__init__(message)
        self.state = state

    @property
    def remedy(self) -> str:
        """Return the remedy for the state, as a sentence."""
        return REMEDIES[self.state]


def is_configuration(path: Path) -> bool:
    """Return whether a path is a file, or a missing ``.toml`` or ``.json``; otherwise it is a data folder."""
    return path.is_file() or (not path.is_dir() and path.suffix in {".toml", ".json"})


def find_folder(path: Path) -> Path:
    """Return the absolute data folder of a configuration or folder; of a rejected configuration, its path."""
    if not is_configuration(path):
        return path.absolute()
    try:
        return load_settings_and_folder(path, None)[1]
    except UsageError:
        return path.absolute()


def read_title(path: Path) -> str:
    """Read the name of a test from its settings; if that is impossible, return that of its folder or file."""
    try:
        with translate_to_absent():
            return _read_settings_and_folder(path)[0].name
    except AbsentError:
        return path.absolute().stem if is_configuration(path) else path.absolute().name


def locate_test(path: Path, access_policy: AccessPolicy) -> tuple[Settings, Path]:
    """Read settings and absolute data folder of a test, without writing.

    Parameters
    ----------
    access_policy
        Policy of the service: without tokens it does not show a test that requires tokens.

    Raises
    ------
    AbsentError
        The test is not available now; its ``state`` gives the kind of reason.
    """
    with translate_to_absent():
        settings, folder = _read_settings_and_folder(path)
        if not folder.is_dir():
            raise AbsentError("missing", f"There is no data folder {folder}.")
        tokens_path = find_tokens_file(settings.web, folder)
        if access_policy.is_open and read_tokens(tokens_path):
            raise AbsentError("locked", f"{tokens_path} holds access tokens, and this service asks for none.")
        return settings, folder


def _read_settings_and_folder(path: Path) -> tuple[Settings, Path]:
    """Read settings and data folder of a test; of a folder alone, the settings stored in it.

    Raises `AbsentError`, or an error of the catalogue (`translate_to_absent`).
    """
    if is_configuration(path):
        try:
            return load_settings_and_folder(path, None)
        except UsageError as error:
            state: Absence = "misconfigured" if path.is_file() else "missing"
            raise AbsentError(state, f"{error}") from error
    folder = path.absolute()
    if not folder.is_dir():
        raise AbsentError("missing", f"There is no data folder {folder}.")
    try:
        require_data_folder(folder)
    except UsageError as error:
        raise AbsentError("foreign", f"{error}") from error
    try:
        return restore_settings(_read_experiment(folder).configuration), folder
    except ValidationError as error:
        raise AbsentError("other_version", f"This version knows no such test: {error}") from error


def _read_experiment(folder: Path) -> ExperimentRow:
    """Read the row of the test from the catalogue, or from its file if the catalogue has none.

    Raises CatalogueError; `NoDataYetError` if neither has it.
    """
    try:
        with open_catalogue(folder) as catalogue:
            return catalogue.read_experiment()
    except NoDataYetError:
        stored = read_experiment_file(folder)  # where the catalogue is lost
        if stored is None:
            raise
        return stored


@contextmanager
def translate_to_absent() -> Iterator[None]:
    """Raise `AbsentError` with the matching state for each error of a data folder within the context.

    Raises
    ------
    AbsentError
        For every SolimonError and OSError.
    """
    try:
        yield
    except AbsentError:
        raise
    except NoDataYetError as error:
        raise AbsentError("no_data", f"{error}") from error
    except SchemaVersionError as error:
        raise AbsentError("other_version", f"{error}") from error
    except CatalogueDamagedError as error:
        raise AbsentError("damaged", f"{error}") from error
    except (SolimonError, OSError) as error:
        raise AbsentError("unreadable", f"{error}") from error
