"""A block-mode oscilloscope as a digitizer of solimon."""
