"""The chain of spheres and the contacts between them. What enters: laws of chain and contact."""
