"""The Reissner-Mindlin plate: elements, grid, load, liquid, reduction."""
