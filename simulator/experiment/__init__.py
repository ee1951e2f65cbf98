"""Changes of the specimen over a test: corrosion, scatter, seeded faults."""
