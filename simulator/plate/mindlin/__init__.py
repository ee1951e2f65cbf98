"""Reissner-Mindlin plate: elements, grid, load, liquid, reduction. Independent of the solid one."""
