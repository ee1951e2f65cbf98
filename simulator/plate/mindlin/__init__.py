"""The Reissner-Mindlin plate: elements, grid, load, liquid, reduction. Unaware of the solid one."""
