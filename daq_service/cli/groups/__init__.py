"""Options of the commands, a module for each section of ``solimon --help``; imported when one is used."""
