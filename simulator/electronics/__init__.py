"""From force to counts: sensor disk, digitizer, what interferes. No mechanics."""
