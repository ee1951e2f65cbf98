"""Parse the command line ``solimon`` and call the command; each command is imported when it is used.

Exit codes: 0 done, 1 a fault of solimon itself, 2 usage or configuration, 3 rig, 4 storage, 5 busy, 6 limits
not met, 130 interrupted.
"""

from __future__ import annotations

import sys
import traceback
from contextlib import suppress
from pathlib import Path

import click

from daq_service.cli.groups.registry import SECTIONS, find_command
from daq_service.errors import (
    EXIT_FAULT,
    EXIT_INTERRUPTED,
    EndedByLibraryError,
    SolimonError,
    StorageError,
    StorageUnavailableError,
)
from daq_service.processes.installation import refuse_hidden_packages
from daq_service.settings.foreign_text import escape_output


class _CommandGroup(click.Group):
    """Group of the commands of the registry, in sections."""

    def invoke(self, ctx: click.Context) -> object:
        """Run a command and exit with its code, 0 if it returns None.

        Raises `EndedByLibraryError` if a library raises SystemExit or another exception that ends processes.
        """
        try:
            ctx.exit(super().invoke(ctx) or 0)
        except (Exception, KeyboardInterrupt):
            raise
        except BaseException as ending:
            raise EndedByLibraryError(ending) from ending

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the names of all commands in the order of the help."""
        return [name for commands in SECTIONS.values() for name in commands]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Return the click command with its options; None if there is no such command."""
        return find_command(name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands to the help by section, with complete summaries."""
        for section, commands in SECTIONS.items():
            with formatter.section(section.upper()):
                formatter.write_dl(list(commands.items()))


@click.group(
    cls=_CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(package_name="solimon")
def cli() -> None:
    """Acquire and monitor with highly nonlinear solitary waves.

    Without hardware: `solimon demo` runs the paper's 350-hour corrosion test on the physics twin.
    """


def print_completion(shell: str) -> None:
    """Print the completion script of a shell that click supports: bash, zsh or fish."""
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None, "click knows each of these shells"
    click.echo(kind(cli, {}, "solimon", "_SOLIMON_COMPLETE").source())


@escape_output()
def main() -> None:
    """Run the command line and exit; each error becomes one line on standard error and an exit code.

    Control characters in the output are escaped.
    """
    try:
        refuse_hidden_packages()
        sys.exit(cli.main(standalone_mode=False))
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.exceptions.Abort, KeyboardInterrupt):
        _exit_with_message("interrupted", EXIT_INTERRUPTED)
    except StorageUnavailableError as error:
        _exit_with_message(f"{error}, then start again", error.exit_code)
    except SolimonError as error:
        _exit_with_message(_format_error(error), error.exit_code)
    except Exception as error:  # noqa: BLE001 - last resort: every error becomes a code and one line
        _exit_with_message(
            f"unforeseen, please report it: {_locate_error(error)}{type(error).__name__}: {error}", EXIT_FAULT
        )


def _format_error(error: SolimonError) -> str:
    """Return the message of an error; if its cause is a lost catalogue, the description of the loss."""
    if isinstance(error, StorageError):
        from daq_service.catalogue.errors import NoDataYetError
        from daq_service.processes.lost_catalogue import describe_loss

        if isinstance(error, NoDataYetError) and error.folder is not None:
            with suppress(StorageError):  # the other files are unreadable, too
                return describe_loss(error.folder) or str(error)
    return str(error)


def _locate_error(error: Exception) -> str:
    """Return file and line of the innermost frame in this project, as ``path, line n: ``.

    Empty if no frame is in the project; the log of a test has the traceback.
    """
    root = Path(__file__).parents[2]
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if Path(frame.filename).is_relative_to(root)]
    return f"{Path(ours[-1].filename).relative_to(root)}, line {ours[-1].lineno}: " if ours else ""


def _exit_with_message(message: str, code: int) -> None:
    """Print ``solimon: message`` on standard error and raise SystemExit with an exit code."""
    from daq_service.processes.printing import print_line

    print_line(f"solimon: {message}")
    sys.exit(code)
