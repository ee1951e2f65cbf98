"""Behind NI-DAQmx's door: tasks, channels, lines, routes, the watchdog."""
