"""One resource of the interface a file; `listing` holds what the listings share."""
