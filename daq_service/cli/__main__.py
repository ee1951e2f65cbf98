"""``python -m daq_service.cli``: the same command without its script, as the supervisor starts children."""

from daq_service.cli import main

main()
