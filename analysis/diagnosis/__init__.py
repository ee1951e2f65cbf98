"""Diagnosis of a change of the features: wall, sensor, coupling or environment."""
