"""What a change of the features comes from: wall, sensor, coupling or environment."""
