"""A set of a position becomes verdict and rows, one file a measuring method. Opens no file."""
