"""Plate models for the chain: the choice of a model (`models`), and modes of a reduced one (`reduced`)."""
