"""All records of a position as one picture: cells of extremes, kept as tiles that may be deleted."""
