"""``solimon status``: how a test stands, as facts, as a table, and watched."""
