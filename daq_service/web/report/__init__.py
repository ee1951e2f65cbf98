"""Report of a test, or of some hours, as one self-contained HTML page that prints on A4."""
