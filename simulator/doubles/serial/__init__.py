"""Supplies and climate probes at the end of a line. What enters: instruments that answer text."""
