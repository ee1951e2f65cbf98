"""A set of a position becomes verdict and rows; an entry of `methods` a measuring method. Opens no file."""
