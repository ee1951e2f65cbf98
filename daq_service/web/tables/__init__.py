"""Tables as files: which there are, their rows in pages, and the formats; for routes and the command line."""
