"""A strike: chain and plate integrated together."""
