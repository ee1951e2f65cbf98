"""``solimon status``: show the status of a test as JSON, as a table, or continuously."""
