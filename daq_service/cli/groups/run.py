"""Commands that start and set up a test."""

from __future__ import annotations

from functools import partial

import click

from daq_service.cli.groups import options
from daq_service.cli.groups.options import argument, build, call, command, group, option, repeated


def _run_demo(**given: object) -> int:
    """Print the first line before the imports: on a cold machine these take seconds."""
    from daq_service.processes.printing import print_line

    print_line("solimon demo: the paper's corrosion test on the physics twin; starting")
    return call("demo:run_demo", **given)


def _run_child(target: str, **given: object) -> int:
    """Run a process that may have a supervisor."""
    from daq_service.cli.run import child_code

    return child_code(partial(call, target), given)


demo = command(
    "demo",
    _run_demo,
    option("--hours", type=options.POSITIVE, help="Stop the test at this hour; default: its end, 350 h."),
    options.SEED,
    option(
        "--pace",
        type=options.POSITIVE,
        help="Test hours per second; default 5, with --exit as fast as possible.",
    ),
    option("--exit", "exit_when_done", is_flag=True, help="Stop when the test is done."),
    *options.PAGE,
    option(
        "--rig",
        type=options.Choice(["simulated", "daqmx-library", "daqmx-grpc"]),
        default="simulated",
        show_default=True,
        help="The twin, or NI's nidaqmx package on doubles of the boards with strikes in real time.",
    ),
    options.DATA_DIR,
    options.JSON,
)
run = command(
    "run",
    "run:run_supervised",
    *options.ONE_TEST,
    option("--port", type=options.PORT_NUMBER, help="Port of the dashboard; default: the configuration's."),
    options.NO_WEB,
)
record = command(
    "record",
    partial(_run_child, "run:record_alone"),
    *options.ONE_TEST,
    option("--linger", is_flag=True, help="Stay after the last set and execute commands."),
    option("--log-json", is_flag=True, help="Print a line of options.JSON for each shot once it is durable."),
    *options.OF_A_CHILD,
)
serve = command(
    "serve",
    partial(_run_child, "serve:serve_tests"),
    argument("paths", metavar="[options.PATH]...", nargs=-1, type=options.PATH),
    options.DATA_DIR,
    option("--port", type=options.PORT_NUMBER, help="Port; 0 takes a free one."),
    option(
        "--web",
        type=options.FILE,
        help="For several tests: a configuration with the [web] table and data folder of the service.",
    ),
    *options.OF_A_CHILD,
    details="PATH is a configuration or a data folder. Several tests are listed at /, each answers below "
    "/tests/NAME/; --data-dir is then the service's own folder: tokens, audit of logins, log.",
)
supply_process = command(
    "supply-process",
    "run:drive_alone",
    *options.ONE_TEST,
    option("--for-recorder", is_flag=True, hidden=True),
    details="It owns the supply's port, writes the log and switches off without a recorder. The recorder "
    "starts it by itself.",
)
setup = command(
    "setup",
    "set_up.setup:run_setup",
    options.NEW_FILE,
    repeated(
        "--transducer",
        "transducers",
        "B=BOARD/INPUT/COUNTER",
        "Wiring of a transducer, for example B=01E16086/ai0/ctr0; with it nothing is asked.",
    ),
    repeated("--probe", "probes", "A=RESOURCE", "NI-SCOPE board of an ultrasonic probe."),
    repeated(
        "--kind",
        "kinds",
        "NAME",
        "Instruments of this installed kind instead of NI boards; then --transducer B=DIGITIZER/STRIKER.",
    ),
    repeated(
        "--set",
        "assignments",
        "KIND.KEY=VALUE",
        "With --kind: a parameter, for example block-scope.range_v=2.0.",
    ),
    option("--supply", default="", metavar="PORT", help="Serial port of the supply."),
    option("--climate", default="", metavar="PORT", help="Serial port of a climate probe."),
    option("--strike", is_flag=True, help="With --transducer: strike each once. Keep hands out of the rig!"),
    option(
        "--drop-height-m",
        type=options.POSITIVE,
        help="Height from which the strikers fall in m; default 0.005.",
    ),
    option("--pulse-s", type=click.FloatRange(1e-3, 0.5), help="Time a coil is on in s; default 0.1."),
    option(
        "--transport",
        type=options.Choice(["library", "grpc"]),
        default="library",
        show_default=True,
        help="Boards of this computer, or of one that runs NI's gRPC device server.",
    ),
    option("--grpc-address", default="", metavar="HOST:PORT", help="Address of that server."),
    option(
        "--data-dir", type=options.FOLDER, help="Folder whose recorder must not run; default: the file's own."
    ),
    *options.PAGE,
    options.JSON,
    details="The proposed settings come from waves that you record. It strikes only when you confirm.",
)
init = command(
    "init",
    "set_up.init:write_configuration",
    argument("kind", type=options.Choice(["twin", "playback", "rig"])),
    options.NEW_FILE,
    option("--source", type=options.PATH, help="playback: folder or file of the recording."),
    repeated("--set", "assignments", "KEY=VALUE", "A value, for example rig.daqmx.*.board_serial=01A2B3C4."),
    repeated("--with", "switch_on", "TABLE", "Switch a table on: rig.climate."),
    repeated("--without", "switch_off", "TABLE", "Switch a table off: rig.supply."),
    options.JSON,
    details="No file is overwritten.",
)
check_config = command(
    "check-config",
    "inspection:print_configuration",
    *options.ONE_TEST_JSON,
    option("--schema", is_flag=True, help="Print the options.JSON Schema of the configuration and stop."),
)
service = command(
    "service",
    "set_up.service:write_services",
    argument("manager", type=options.Choice(["systemd", "windows"])),
    options.CONFIG_FILE,
    options.DATA_DIR,
    option("--user", help="User that runs them; default: you."),
    option("--name", default="solimon", show_default=True, help="First part of their names."),
    option("--out", type=options.FOLDER, default=".", help="Folder of the files; default: this one."),
    options.JSON,
)
doctor = command(
    "doctor",
    "doctor.command:run_doctor",
    *options.ONE_TEST_JSON,
    option("--strike", metavar="POSITION", help="Also strike this transducer; on boards twice."),
    details="Nothing strikes without --strike.",
)
token = group(
    "token",
    build(
        "create",
        "set_up.token:run_create",
        argument("name"),
        option(
            "--role",
            required=True,
            type=options.Choice(["viewer", "operator", "engineer", "admin"]),
            help="Each may do what those before it may.",
        ),
        option("--days", type=options.POSITIVE, help="Days until it expires; default: never."),
        *options.ONE_TEST_JSON,
        text="Create a token for NAME and print it once.",
    ),
    build(
        "list",
        "set_up.token:run_list",
        *options.ONE_TEST_JSON,
        text="List the tokens: name, role, state, expiry.",
    ),
    build(
        "revoke",
        "set_up.token:run_revoke",
        argument("name"),
        *options.ONE_TEST_JSON,
        text="Revoke NAME's token; its pages end within seconds.",
    ),
    details="A running service follows at once.",
)
notify = group(
    "notify",
    build(
        "test",
        "set_up.notify:run_test",
        options.CONFIG,
        option("--receiver", metavar="NAME", help="This receiver only; default: all."),
        options.JSON,
        text="Send each receiver one marked test message and print the results.",
    ),
)


def _print_completion(shell: str) -> None:
    """Print the completion script of one of click's shells."""
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None, "click knows each of these shells"
    root = click.get_current_context().find_root().command
    click.echo(kind(root, {}, "solimon", "_SOLIMON_COMPLETE").source())


completion = command(
    "completion",
    _print_completion,
    argument("shell", type=options.Choice(["bash", "zsh", "fish"])),
    details="\b\n"
    'bash: eval "$(solimon completion bash)"   as a line of ~/.bashrc\n'
    'zsh:  eval "$(solimon completion zsh)"    as a line of ~/.zshrc\n'
    "fish: solimon completion fish | source    as a line of ~/.config/fish/config.fish",
)
