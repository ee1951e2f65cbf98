"""Algebra, lanes, caches and keyed random numbers: nothing of waves."""
