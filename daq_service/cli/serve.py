"""``serve``: run the web service of one or more tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daq_service.cli.run import run_as_child, serve_alone, serve_app
from daq_service.errors import UsageError
from daq_service.processes.child import log_to_file
from daq_service.processes.data_folder import choose_folder, prepare_data_folder
from daq_service.processes.printing import print_line
from daq_service.settings.file import load_settings

OWN_FOLDER = "solimon-service"
"""Default folder of a service of multiple tests."""


@run_as_child
def serve_tests(
    *,
    paths: Sequence[Path],
    data_dir: Path | None,
    port: int | None,
    web: Path | None,
    restart_reason: str,
    supervised: bool,
) -> int:
    """Run `solimon serve`: serve one or several tests until a person stops it, and return the exit code.

    Raises
    ------
    UsageError
        Options do not go together, or as `run.serve_alone`.
    BusyError
        The port is in use.
    StorageError
        The folder is missing after a restart, or cannot be written.
    """
    if len(paths) > 1:
        return _serve_all_tests(paths, data_dir, port, web)
    if web is not None:
        raise UsageError(
            "--web is for several tests; of a single one, its own configuration has the table [web]"
        )
    config = paths[0] if paths else None
    if config is not None and config.is_dir():
        if data_dir is not None:
            raise UsageError(f"both {config} and --data-dir {data_dir} name a data folder; give one of them")
        config, data_dir = None, config
    return serve_alone(
        config=config,
        data_dir=data_dir,
        port=port,
        restart_reason=restart_reason,
        supervised=supervised,
    )


def _serve_all_tests(paths: Sequence[Path], data_dir: Path | None, port: int | None, web: Path | None) -> int:
    """Serve several tests with one web service and return the exit code.

    Tokens, logins and log are in the service's own folder, by default `OWN_FOLDER` in the working directory.
    Raises UsageError if the address needs protection that is missing, BusyError if the port is in use,
    StorageError if the folder cannot be used.
    """
    from daq_service.web.auth.middleware import refuse_unprotected_service
    from daq_service.web.multi_test.app import create_multi_test_app

    settings = load_settings(web)
    service_folder = Path.cwd() / OWN_FOLDER if web is None else choose_folder(settings.storage, web, None)
    folder = service_folder if data_dir is None else data_dir.absolute()
    refuse_unprotected_service(settings.web, folder)
    app = create_multi_test_app(paths, settings, folder)
    prepare_data_folder(folder)
    log_to_file(folder / "logs" / "web.log")
    print_line(f"the service's own folder (tokens, logins, log): {folder}")
    return serve_app(app, settings.web, port)
