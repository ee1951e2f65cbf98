"""Command line: a module or package for each command; commands import heavy modules when they run."""


def main() -> None:
    """Run the command line and end the process with its exit code.

    Resets inherited streams, signals and limits first. The commands are imported only here, so that this
    package is imported fast.
    """
    from daq_service.processes.inherited import reset_inherited_settings

    reset_inherited_settings()
    from daq_service.cli.main import main as run_command_line
    from daq_service.processes.printing import force_exit_if_needed

    try:
        run_command_line()
    except SystemExit as ending:
        force_exit_if_needed(ending.code if isinstance(ending.code, int) else int(ending.code is not None))
        raise
