"""Every knob of the twin with its unit, bounds and meaning; no computation."""
