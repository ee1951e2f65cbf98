"""Plates as the chain feels them: which model (`models`), and modes of a reduced one (`reduced`)."""
