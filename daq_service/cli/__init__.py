"""A file or folder for each word behind ``solimon``; heavy imports stand inside a command."""


def main() -> None:
    """Run the command line; imported when it is called, so that importing this room costs nothing."""
    from daq_service.cli.main import main as run_command_line

    run_command_line()
