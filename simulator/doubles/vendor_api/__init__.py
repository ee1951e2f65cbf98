"""The vendors' entry points, attributes and statuses as tables, and how they go over the wire."""
