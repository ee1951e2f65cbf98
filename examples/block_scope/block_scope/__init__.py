"""Digitizer of solimon: a block-mode oscilloscope."""
