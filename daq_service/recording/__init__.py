"""The line in reading order: session, recorder, ledger; and what it shows while it runs."""
