"""Shared rigs, brains, folders and records for tests."""
