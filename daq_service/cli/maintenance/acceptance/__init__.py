"""``certify``: acceptance report of a test: `evidence`, quantities, `criteria`, then `page`."""
