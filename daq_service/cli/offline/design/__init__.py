"""``solimon design``: what arrays of spheres know about the wall, and the best of them."""
