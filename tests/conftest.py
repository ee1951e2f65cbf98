"""Puts `tests/` on the import path, so that tests of every kind share `support`."""
