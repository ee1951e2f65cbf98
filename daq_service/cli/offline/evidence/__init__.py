"""A stored test judged once more by the service's own line: why an alarm stands, what other settings say."""
