"""Runs the rig: records, stores, analyses, serves and supervises."""
