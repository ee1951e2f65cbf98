"""Waterfall plot of all records of a position: cells of extremes, cached in tiles that may be deleted."""
