"""The configuration: its tree of keys, reading it from a file, comparing it with a stored one."""
