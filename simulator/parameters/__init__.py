"""Parameters of the twin, each with its unit, bounds and meaning; no computation."""
