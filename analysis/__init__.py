"""Analysis from shot to assessment: pure functions of arrays and numbers; no I/O, clock or output."""
