"""Supply that corrodes the plate: switching, supervision, charge, log. Nothing else switches it."""
