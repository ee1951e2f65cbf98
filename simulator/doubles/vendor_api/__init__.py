"""Tables of the vendors' entry points, attributes and statuses, and their encoding on the wire."""
