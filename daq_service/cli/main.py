"""Parse the command line ``solimon`` and call the command; heavy modules are imported inside commands.

Exit codes: 0 done, 1 a fault of solimon itself, 2 usage or configuration, 3 rig, 4 storage, 5 busy, 6 not
certified, 130 interrupted.
"""

from __future__ import annotations

import math
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import click

from daq_service.errors import (
    EXIT_FAULT,
    EXIT_INTERRUPTED,
    EndedByLibraryError,
    SolimonError,
    StorageError,
    StorageUnavailableError,
)
from daq_service.settings.foreign_text import plain_output


class _Positive(click.FloatRange):
    """Positive finite number: a range alone accepts infinity and NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is no finite number.", param, ctx)
        return number


FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
PORT_NUMBER = click.IntRange(0, 65535)
POSITIVE = _Positive(min=0.0, min_open=True)

CONFIG = click.argument("config", required=False, type=FILE)
DATA_DIR = click.option("--data-dir", type=FOLDER, help="Data folder; default: the configuration's.")
SEED = click.option("--seed", type=click.IntRange(min=0), help="Seed of the twin's random numbers.")
RESTARTED = click.option("--restart-reason", default="", hidden=True)
JSON = click.option("--json", "as_json", is_flag=True, help="One JSON object on standard output.")
POSITION = click.option("--position", required=True, help="The transducer's position, for example B.")
EXECUTORS = "processes|threads|dask://HOST"
SUPERVISED = click.option("--supervised", is_flag=True, hidden=True)


def of_a_test(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that select one test."""
    return CONFIG(DATA_DIR(command))


def order_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add the options of a command to a running recorder."""
    command = JSON(command)
    command = click.option("--author", help="Who gives the order; default: this user.")(command)
    return click.option("--note", "--reason", "note", default="", help="Why; a hold and a renewal need it.")(
        command
    )


class _CommandGroup(click.Group):
    """Group that shows the complete summary of each command."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command and exit with its code; a library that ends the process is an error."""
        try:
            ctx.exit(super().invoke(ctx) or 0)
        except (Exception, KeyboardInterrupt):
            raise
        except BaseException as ending:
            raise EndedByLibraryError(ending) from ending

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the section of the commands; click itself would cut them to a line."""
        shown = [(name, command) for name, command in sorted(self.commands.items()) if not command.hidden]
        with formatter.section("Commands"):
            formatter.write_dl([(name, command.get_short_help_str(sys.maxsize)) for name, command in shown])


@click.group(
    cls=_CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(package_name="solimon")
def cli() -> None:
    """Acquire and monitor with highly nonlinear solitary waves.

    Without hardware: `solimon demo` runs the paper's 350-hour corrosion test on the physics twin.
    """


@cli.command()
@click.option("--hours", type=POSITIVE, help="Stop the test at this hour; default: its end, 350 h.")
@SEED
@click.option(
    "--pace", type=POSITIVE, help="Hours of test a second; default 5, with --exit as fast as it goes."
)
@click.option(
    "--port",
    type=PORT_NUMBER,
    default=0,
    show_default=True,
    help="Port of the dashboard; 0 takes a free one.",
)
@click.option("--exit", "exit_when_done", is_flag=True, help="Stop when the test is done.")
@click.option("--no-web", is_flag=True, help="Without dashboard.")
@click.option("--no-browser", is_flag=True, help="Do not open the dashboard in a browser.")
@click.option(
    "--rig",
    type=click.Choice(["simulated", "daqmx-library", "daqmx-grpc"]),
    default="simulated",
    show_default=True,
    help="The twin itself, or NI's own nidaqmx package on doubles of the boards, in real time a strike.",
)
@DATA_DIR
@JSON
def demo(**options: Any) -> int:
    """Run the paper's experiment on the twin and show it live."""
    # Before anything heavy is imported: on a cold machine that takes seconds.
    from daq_service.processes.printing import print_line

    print_line("solimon demo: the paper's corrosion test on the physics twin; starting")
    from daq_service.cli.demo import run_demo

    return run_demo(**options)


@cli.command()
@of_a_test
@click.option("--port", type=PORT_NUMBER, help="Port of the dashboard; default: the configuration's.")
@click.option("--no-web", is_flag=True, help="Without dashboard.")
def run(**options: Any) -> int:
    """Record and serve under a supervisor that restarts what fails."""
    from daq_service.cli.run import run_supervised

    return run_supervised(**options)


@cli.command()
@of_a_test
@click.option("--linger", is_flag=True, help="Stay after the last set and carry out orders.")
@click.option("--log-json", is_flag=True, help="Print a line of JSON for each shot once it is durable.")
@RESTARTED
@SUPERVISED
def record(**options: Any) -> int:
    """Record only: own the rig and the data folder, follow the schedule."""
    from daq_service.cli.run import child_code, record_alone

    return child_code(record_alone, options)


@cli.command()
@click.argument("paths", metavar="[PATH]...", nargs=-1, type=click.Path(path_type=Path))
@DATA_DIR
@click.option("--port", type=PORT_NUMBER, help="Port; 0 takes a free one.")
@click.option(
    "--web",
    type=FILE,
    help="Of several tests: a configuration; its [web] table and data folder are the service's own.",
)
@RESTARTED
@SUPERVISED
def serve(**options: Any) -> int:
    """Serve only: REST, stream and dashboard of a test, or of several.

    PATH is a configuration or a data folder. Several tests are listed at /, each answers below /tests/NAME/;
    --data-dir is then the service's own folder: tokens, audit of logins, log.
    """
    from daq_service.cli.run import child_code
    from daq_service.cli.serve import serve_tests

    return child_code(serve_tests, options)


@cli.command()
@of_a_test
@click.option("--for-recorder", is_flag=True, hidden=True)
def drive(**options: Any) -> int:
    """Own the corrosion drive's port beside a recorder, which starts this by itself; never energises."""
    from daq_service.cli.run import drive_alone

    return drive_alone(**options)


@cli.command("check-config")
@of_a_test
@click.option("--schema", is_flag=True, help="Print the JSON Schema of the configuration and stop.")
@JSON
def check_config(**options: Any) -> None:
    """Read a configuration and say what it will do: sets, shots, bytes, end, free disk."""
    from daq_service.cli.inspection import print_configuration

    print_configuration(**options)


@cli.command()
@click.argument("kind", type=click.Choice(["twin", "playback", "rig"]))
@click.argument("file", type=FILE)
@click.option("--source", type=click.Path(path_type=Path), help="playback: folder or file of the recording.")
@click.option(
    "--set",
    "assignments",
    metavar="KEY=VALUE",
    multiple=True,
    help="A key's value, for example rig.daqmx.*.board_serial=01A2B3C4; may be given several times.",
)
@click.option("--with", "switch_on", metavar="TABLE", multiple=True, help="Switch a table on: rig.climate.")
@click.option("--without", "switch_off", metavar="TABLE", multiple=True, help="Switch one off: rig.supply.")
@JSON
def init(**options: Any) -> None:
    """Write a commented configuration to FILE, with its schema beside it; nothing is written over."""
    from daq_service.cli.set_up.init import write_configuration

    write_configuration(**options)


@cli.command()
@click.argument("file", type=FILE)
@click.option(
    "--transducer",
    "transducers",
    metavar="B=BOARD/INPUT/COUNTER",
    multiple=True,
    help="A transducer's wiring, for example B=01E16086/ai0/ctr0; with it nothing is asked.",
)
@click.option(
    "--probe", "probes", metavar="A=RESOURCE", multiple=True, help="An ultrasonic probe's NI-SCOPE board."
)
@click.option(
    "--kind",
    "kinds",
    metavar="NAME",
    multiple=True,
    help="Instruments of this installed kind instead of NI boards; then --transducer B=DIGITIZER/STRIKER.",
)
@click.option(
    "--set",
    "assignments",
    metavar="KIND.KEY=VALUE",
    multiple=True,
    help="With --kind: a parameter, for example block-scope.range_v=2.0.",
)
@click.option("--supply", default="", metavar="PORT", help="Serial port of the supply.")
@click.option("--climate", default="", metavar="PORT", help="Serial port of a climate probe.")
@click.option("--strike", is_flag=True, help="With --transducer: strike each once. Nobody's hands inside!")
@click.option("--drop-height-m", type=POSITIVE, help="Height the strikers fall from in m; default 0.005.")
@click.option("--pulse-s", type=click.FloatRange(1e-3, 0.5), help="Time a coil is on in s; default 0.1.")
@click.option(
    "--transport",
    type=click.Choice(["library", "grpc"]),
    default="library",
    show_default=True,
    help="Boards of this computer, or of one that runs NI's gRPC device server.",
)
@click.option("--grpc-address", default="", metavar="HOST:PORT", help="That server's address.")
@click.option("--data-dir", type=FOLDER, help="Folder whose recorder must not run; default: the file's own.")
@click.option(
    "--port", type=PORT_NUMBER, default=0, show_default=True, help="Port of the page; 0: a free one."
)
@click.option("--no-web", is_flag=True, help="Without the page.")
@click.option("--no-browser", is_flag=True, help="Do not open the page.")
@JSON
def setup(**options: Any) -> None:
    """Lead from boards to a configuration by your own waves. Strikes on your word only."""
    from daq_service.cli.set_up.setup import run_setup

    run_setup(**options)


@cli.command()
@click.argument("manager", type=click.Choice(["systemd", "windows"]))
@click.argument("config", type=FILE)
@DATA_DIR
@click.option("--user", help="Who runs them; default: you.")
@click.option("--name", default="solimon", show_default=True, help="Their names begin so.")
@click.option("--out", type=FOLDER, default=".", help="Folder of the files; default: this one.")
@JSON
def service(**options: Any) -> None:
    """Write services of this computer that run a test from its start on, and say how to install them."""
    from daq_service.cli.set_up.service import write_services

    write_services(**options)


@cli.group()
def token() -> None:
    """Access tokens of the web service: create, list, revoke; a running service follows at once."""


@token.command("create")
@click.argument("name")
@click.option(
    "--role",
    required=True,
    type=click.Choice(["viewer", "operator", "engineer", "admin"]),
    help="Each may do what those before it may.",
)
@click.option("--days", type=POSITIVE, help="Until it expires; default: never.")
@of_a_test
@JSON
def token_create(**options: Any) -> None:
    """Make a token for NAME and print it once; orders that it gives bear this name."""
    from daq_service.cli.set_up.token import run_create

    run_create(**options)


@token.command("list")
@of_a_test
@JSON
def token_list(**options: Any) -> None:
    """List the tokens: name, role, state, until when."""
    from daq_service.cli.set_up.token import run_list

    run_list(**options)


@token.command("revoke")
@click.argument("name")
@of_a_test
@JSON
def token_revoke(**options: Any) -> None:
    """Let NAME's token open nothing any more; open pages and streams end within seconds."""
    from daq_service.cli.set_up.token import run_revoke

    run_revoke(**options)


@cli.group()
def notify() -> None:
    """Who is told of alarms elsewhere ([notifications] of the configuration)."""


@notify.command("test")
@CONFIG
@click.option("--receiver", metavar="NAME", help="This one only; default: all.")
@JSON
def notify_test(**options: Any) -> int:
    """Send each receiver one message that is marked as a trial, and say what became of it."""
    from daq_service.cli.set_up.notify import run_test

    return run_test(**options)


@cli.command()
@of_a_test
@click.option("--strike", metavar="POSITION", help="Also strike this transducer; on boards twice.")
@JSON
def doctor(**options: Any) -> int:
    """Look at software, rig, data folder and clocks; says what to do. Strikes nothing unless told to."""
    from daq_service.cli.doctor.command import run_doctor

    return run_doctor(**options)


@cli.command()
@of_a_test
@click.option("--watch", is_flag=True, help="Show it anew every second, until Ctrl-C; needs a terminal.")
@JSON
def status(**options: Any) -> int:
    """Say how a test stands: recorder, last sets, features, alarms."""
    from daq_service.cli.status.command import run_status

    return run_status(**options)


@cli.command(
    help="Print what makes a shell complete words and options of solimon.\n\n\b\n"
    'bash: eval "$(solimon completion bash)"   as a line of ~/.bashrc\n'
    'zsh:  eval "$(solimon completion zsh)"    as a line of ~/.zshrc\n'
    "fish: solimon completion fish | source    as a line of ~/.config/fish/config.fish"
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print it for one of click's shells."""
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None, "click knows each of these shells"
    click.echo(kind(cli, {}, "solimon", "_SOLIMON_COMPLETE").source())


@cli.command()
@click.option("--data-dir", type=FOLDER, required=True, help="The test's data folder.")
@JSON
def rebuild(**options: Any) -> None:
    """Make a lost or damaged catalogue again, from the sets and the history; the old one is kept."""
    from daq_service.cli.maintenance.rebuild import print_rebuilt

    print_rebuilt(**options)


def add_order(kind: str, explanation: str, *options: Callable[..., Any]) -> None:
    """Add a command for the recorder; its options are the arguments."""
    command = order_options(partial(_send_order, kind))
    for option in (*options, DATA_DIR, CONFIG):
        command = option(command)
    cli.command(kind.replace("_", "-"), help=explanation)(command)


REASONS = {
    "pause": (
        "a hold needs a reason, for whoever finds it: --reason 'hands in the rig'",
        "Why is the test held",
    ),
    "renew_baseline": (
        "a baseline is retired for a reason, which stays with it: --reason 'the sensor was coupled anew'",
        "Why is the baseline retired",
    ),
}
"""Error for a command without its reason, and the question at a terminal."""


def _send_order(kind: str, **options: Any) -> int:
    """Ask for a missing reason and send the command."""
    if kind in REASONS and not options["note"].strip():
        message, question = REASONS[kind]
        if not sys.stdin.isatty():
            raise click.UsageError(message)
        options["note"] = click.prompt(question, err=True)
    from daq_service.commands.send import send_command

    return send_command(kind, **options)


add_order("pause", "Strike no more until `resume`: somebody works at the rig. Sets that fall due are missed.")
add_order("resume", "End a hold: the next due set is taken.")
add_order("trust_clock", "Go on with this computer's clock though it is doubted after a restart.")
add_order("disable", "Let a transducer strike no more, until `enable`.", POSITION)
add_order("enable", "Let a retired transducer strike again, from the next set on.", POSITION)
add_order("strike", "Strike a confirmation set at a transducer now, beside the plan.", POSITION)
add_order("approve_baseline", "Sign the proposed baseline of a transducer.", POSITION)
add_order(
    "renew_baseline",
    "Retire a transducer's baseline, with --reason: another one is collected from the next planned set on.",
    POSITION,
)


@cli.command()
@of_a_test
@click.option("--on/--off", "on", default=None, help="Switch the corrosion drive on or off.")
@click.option("--voltage-v", type=float, help="With --on: voltage in V; default: the configuration's.")
@click.option("--current-limit-a", type=float, help="With --on: limit in A; default: the configuration's.")
@order_options
def supply(on: bool | None, voltage_v: float | None, current_limit_a: float | None, **options: Any) -> int:
    """Switch the corrosion drive of a running test; nothing else ever switches it on."""
    if on is None:
        raise click.UsageError("say --on or --off")
    if not on and (voltage_v is not None or current_limit_a is not None):
        raise click.UsageError("--voltage-v and --current-limit-a belong to --on")
    values = {"voltage_v": voltage_v, "current_limit_a": current_limit_a} if on else {}
    return _send_order("supply_on" if on else "supply_off", **values, **options)


@cli.command()
@CONFIG
@click.option(
    "--model",
    type=click.Choice(["coupled", "zener"]),
    default="coupled",
    help="coupled: chain and plate together (default); zener: the last sphere strikes a large plate.",
)
@click.option("--position", help="Use this position's chain, plate and footprint.")
@click.option("--depth", "depth_fraction", type=float, help="Lost part of the thickness, 0 to 0.95.")
@click.option("--drop-height-m", type=float, help="Drop height of the striker in m.")
@click.option("--tilt-rad", type=float, help="Tilt of the sensor disk in rad.")
@click.option("--depths", help="Short for --sweep corrosion.depth_fraction=..., for example 0:0.8:9.")
@click.option(
    "--sweep",
    "sweeps",
    metavar="KEY=VALUES",
    multiple=True,
    help="Values of a key: a,b,c or first:last:count or log:first:last:count; several make a grid.",
)
@click.option("--sweep-file", type=FILE, help="CSV file: a header of keys, then one row a shot.")
@click.option("--zip", "element_wise", is_flag=True, help="First values together, then second ones: no grid.")
@click.option("--skip-invalid", is_flag=True, help="Keep refused combinations as rows with their reason.")
@click.option(
    "--out",
    "outputs",
    multiple=True,
    type=click.Path(path_type=Path),
    help="File of the sweep's table: .csv, .h5 or .parquet; may be given several times.",
)
@click.option("--waveforms", is_flag=True, help="Store the forces at the sensor, too (.h5 only).")
@click.option("--workers", type=click.IntRange(1, 256), help="Default: one for each core.")
@click.option(
    "--executor",
    metavar=EXECUTORS,
    help="Default: threads for a short sweep, processes for a long one; a cluster needs the extra.",
)
@click.option("--overwrite", is_flag=True, help="Replace outputs that exist.")
@JSON
def simulate(**options: Any) -> None:
    """One shot of the physics twin, or a sweep over any parameters of chain, plate and corrosion."""
    from daq_service.cli.simulate import print_simulation

    print_simulation(**options)


@cli.command()
@click.option("--out", type=FOLDER, help="Folder for figures, tables and report; default: a new one here.")
@click.option(
    "--from",
    "data_dir",
    type=FOLDER,
    help="Data folder of a test; default: the paper's test is run on the twin.",
)
@click.option("--only", metavar="NAMES", help="Some of them only, for example fig12,table2.")
@SEED
@JSON
def reproduce(**options: Any) -> int:
    """Draw the paper's figures and tables from a test and the models, and say where they deviate."""
    from daq_service.cli.reproduce.run import reproduce as carry_out

    return carry_out(**options)


FOLDER_ALONE = click.option("--data-dir", type=FOLDER, required=True, help="Data folder of the test.")


@cli.command()
@FOLDER_ALONE
@JSON
def verify(**options: Any) -> int:
    """Check everything stored: frames, files, rows against files both ways; beside a running test, too."""
    from daq_service.cli.maintenance.command import run_verify

    return run_verify(**options)


@cli.command()
@FOLDER_ALONE
@click.option("--apply", is_flag=True, help="Do it; without, it is only said. Needs a stopped recorder.")
@click.option("--from", "backup", type=FOLDER, help="A backup of this test, for files that are lost.")
@JSON
def repair(**options: Any) -> int:
    """Mend what needs no guess; says what it would do, and what only a person can."""
    from daq_service.cli.maintenance.command import run_repair

    return run_repair(**options)


@cli.command()
@click.argument("destination", type=FOLDER)
@FOLDER_ALONE
@JSON
def backup(**options: Any) -> int:
    """Copy a test to DESTINATION while it runs; a second backup copies only what is new."""
    from daq_service.cli.maintenance.command import run_backup

    return run_backup(**options)


@cli.command()
@FOLDER_ALONE
@click.option("--hdf5", type=FILE, help="One HDF5 file of the whole test; records stay in the sets' files.")
@click.option("--table", metavar="NAME", help="Instead: a table, such as features, verdicts or alarms.")
@click.option("--waveforms", metavar="POSITION", help="Instead: records of a position, in volts.")
@click.option(
    "--out",
    "targets",
    multiple=True,
    type=FILE,
    help="Its file: .csv, .parquet, .arrow, .npz, .mat or .h5; may be given several times.",
)
@click.option("--position", help="Of the table: this position only.")
@click.option("--from-h", type=float, help="Of table or records: from this hour on.")
@click.option("--to-h", type=float, help="Of table or records: before this hour.")
@click.option("--first-set", type=click.IntRange(min=0), help="Of the records: from this set on.")
@click.option("--last-set", type=click.IntRange(min=0), help="Of the records: up to this set.")
@click.option(
    "--purpose",
    type=click.Choice(["planned", "confirmation", "any"]),
    help="Of the table: sets of the plan (default), confirmation sets beside it, or both.",
)
@click.option("--fields", metavar="NAMES", help="Of the table: these columns only, for example tof_pp_s.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@JSON
def export(**options: Any) -> int:
    """Write a test, also one that runs, for other programs: all of it as HDF5, a table, or records."""
    from daq_service.cli.maintenance.command import run_export

    return run_export(**options)


@cli.command()
@FOLDER_ALONE
@click.option("--html", type=FILE, help="Write it as one page with pictures, which prints on paper.")
@click.option(
    "--json",
    "to_json",
    is_flag=False,
    flag_value="-",
    metavar="[FILE]",
    help="Write it as JSON to FILE; without one, to standard output.",
)
@click.option(
    "--limit",
    "limits",
    metavar="NAME=VALUE",
    multiple=True,
    help="Another limit of a criterion; NAME=off leaves it out. May be given several times.",
)
@click.option("--verify", is_flag=True, help="Check everything stored, too, as `solimon verify` does.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
def certify(**options: Any) -> int:
    """Certify a test that runs or has ended: shots, gaps, faults, delays, memory, disk, clock, a verdict."""
    from daq_service.cli.maintenance.command import run_certify

    return run_certify(**options)


@cli.command()
@click.argument("where", metavar="CONFIG_OR_DATA", type=click.Path(exists=True, path_type=Path))
@click.option("--from-h", type=float, help="From this hour on.")
@click.option("--to-h", type=float, help="Before this hour.")
@click.option("--out", type=FILE, help="Its file; default: report_FOLDER.html here.")
@click.option("--overwrite", is_flag=True, help="Replace a file that exists.")
@JSON
def report(**options: Any) -> None:
    """Write a test, also one that runs, or some hours of it as one HTML page that prints on paper."""
    from daq_service.cli.maintenance.report import write_report

    write_report(**options)


@cli.command()
@click.argument("tables", metavar="TABLE...", nargs=-1, required=True, type=FILE)
@click.option("--baseline-rows", type=click.IntRange(min=1), help="The first so many rows are the baseline.")
@click.option(
    "--baseline-where", metavar="COLUMN=VALUE", help="Instead: the rows whose column has this value."
)
@click.option("--features", metavar="NAMES", help="These columns only, for example tof_pp_s; default: all.")
@click.option(
    "--budget", type=POSITIVE, default=0.2, show_default=True, help="False alarms a sensor and year."
)
@click.option("--sets-per-day", type=POSITIVE, default=24.0, show_default=True, help="Rows a day.")
@click.option("--no-rows", is_flag=True, help="With --json: without a line for each row.")
@click.option("--fleet", is_flag=True, help="Also judge all tables together: rows of the same times.")
@click.option(
    "--false-discovery-rate",
    type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    default=0.1,
    show_default=True,
    help="Part of the sensors raised with --fleet that may be healthy.",
)
@JSON
def assess(**options: Any) -> None:
    """Judge tables of features (.csv, .parquet, .npy; a row a set, a sensor a table) as the service would."""
    from daq_service.cli.offline.assess import run_assess

    run_assess(**options)


@cli.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@click.option("--rate-hz", type=POSITIVE, help="Sample rate; default: 10 MHz.")
@click.option("--pretrigger-s", type=POSITIVE, help="From a record's begin to its trigger; default: 100 us.")
@click.option("--volts-per-count", type=POSITIVE, help="The values are counts of an ADC; default: volts.")
@click.option("--rail-counts", metavar="LOW,HIGH", help="Counts at which the ADC clips.")
@click.option("--isw-fwhm-s", type=POSITIVE, help="Usual width of the incident wave; default: as learnt.")
@click.option("--isw-amplitude-v", type=POSITIVE, help="Its usual amplitude; default: as learnt.")
@click.option("--psw-window-s", metavar="FROM,TO", help="Where the reflected wave is sought, after the ISW.")
@JSON
def features(**options: Any) -> None:
    """Extract features and flags of records (.npy, .csv, a set's .h5, .tdms) as the service would."""
    from daq_service.cli.offline.features import run_features

    run_features(**options)


@cli.command()
@click.argument("alarm_id", metavar="ALARM", type=click.IntRange(min=1))
@FOLDER_ALONE
@click.option("--out", type=FOLDER, help="Folder for page and JSON; default: a new one here.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@JSON
def explain(**options: Any) -> None:
    """Recompute an alarm from the stored records and write why it stands: a page with pictures, and JSON."""
    from daq_service.cli.offline.evidence.explain import run_explain

    run_explain(**options)


@cli.command()
@click.argument("data_dir", type=FOLDER)
@click.option(
    "--set",
    "given",
    metavar="KEY=VALUE",
    multiple=True,
    help="Judge by this setting instead, for example alarms.decides_by=chart; may be given several times.",
)
@click.option("--extract", is_flag=True, help="Extract the features from the waveforms again first.")
@click.option("--executor", metavar=EXECUTORS, help="With --extract: who does it; default: threads.")
@click.option("--workers", type=click.IntRange(1, 256), help="With --extract: default one for each core.")
@JSON
def replay(**options: Any) -> None:
    """Judge a stored test again, with other settings or another version, and list what changes."""
    from daq_service.cli.offline.evidence.replay import run_replay

    run_replay(**options)


@plain_output()
def main() -> None:
    """Run the command line; errors become one line and their exit code."""
    try:
        sys.exit(cli.main(standalone_mode=False))
    except click.exceptions.Abort:
        _end("interrupted", EXIT_INTERRUPTED)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        _end("interrupted", EXIT_INTERRUPTED)
    except StorageUnavailableError as error:
        _end(f"{error}, then start again", error.exit_code)
    except SolimonError as error:
        _end(_message_of(error), error.exit_code)
    except Exception as error:  # noqa: BLE001 - last resort: every error becomes a code and one line
        _end(f"unforeseen, please report it: {_where(error)}{type(error).__name__}: {error}", EXIT_FAULT)


def _message_of(error: SolimonError) -> str:
    """Return the message of an error; if the catalogue is lost, state that."""
    if isinstance(error, StorageError):
        from daq_service.catalogue.errors import NoDataYetError
        from daq_service.processes.lost_catalogue import lost_reason

        if isinstance(error, NoDataYetError) and error.folder is not None:
            with suppress(StorageError):  # the other files are unreadable, too
                return lost_reason(error.folder) or str(error)
    return str(error)


def _where(error: Exception) -> str:
    """Return the location in this project where an error occurred; a running test's log has the traceback."""
    root = Path(__file__).parents[2]
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if Path(frame.filename).is_relative_to(root)]
    return f"{Path(ours[-1].filename).relative_to(root)}, line {ours[-1].lineno}: " if ours else ""


def _end(message: str, code: int) -> None:
    """Print a message and exit."""
    from daq_service.processes.printing import print_line

    print_line(f"solimon: {message}")
    sys.exit(code)
