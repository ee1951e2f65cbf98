"""NI-SCOPE double: sessions, pulsers, records."""
