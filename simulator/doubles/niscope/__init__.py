"""Behind NI-SCOPE's door: sessions, pulsers, records."""
