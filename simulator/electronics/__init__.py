"""Electronics from force to counts: sensor disk, digitizer, interference. No mechanics."""
