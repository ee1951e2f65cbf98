"""NI-DAQmx double: tasks, channels, lines, routes, the watchdog."""
