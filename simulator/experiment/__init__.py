"""What happens to the specimen over a test: corrosion, scatter, seeded faults."""
