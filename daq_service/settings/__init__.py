"""The configuration: the tree of keys, and reading it from a file."""
