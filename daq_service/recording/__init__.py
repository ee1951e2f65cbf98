"""The line in reading order: session, recorder, safekeeping, ledger; and what it shows while it runs."""
