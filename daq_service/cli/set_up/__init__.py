"""Prepare a computer for a test: configuration (`init`, `setup`) and services (`service`)."""
