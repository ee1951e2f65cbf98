"""Chain of spheres and the contacts between them."""
