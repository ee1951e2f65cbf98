"""What a computer needs before a test: a configuration (`init`, `setup`), its services (`service`)."""
