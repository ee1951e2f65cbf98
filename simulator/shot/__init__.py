"""A strike: chain and plate integrated together. What enters: time integration and what it needs."""
