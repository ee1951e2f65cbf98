"""The chain of spheres and the contacts between them."""
