"""Doubles of instruments with a text protocol: supplies and climate probes on a line."""
