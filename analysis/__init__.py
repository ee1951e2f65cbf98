"""From shot to verdict. What enters: pure functions of arrays and numbers; no I/O, clock or output."""
