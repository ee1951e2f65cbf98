"""The supply that corrodes the plate: switch, watch, charge, log. Nothing else switches it."""
