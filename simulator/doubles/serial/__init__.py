"""Supplies and climate probes at the end of a line."""
