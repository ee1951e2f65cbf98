"""Reassess a stored test by the service's own code: explain an alarm, or compare other settings."""
