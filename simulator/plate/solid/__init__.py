"""The three-dimensional plate of high order."""
