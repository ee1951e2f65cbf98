"""From shot to verdict: pure functions without I/O, clock or output."""
