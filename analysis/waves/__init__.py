"""Pulses, features and quality flags of a solitary-wave record. No statistics over sets."""
