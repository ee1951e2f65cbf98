"""``certify``: what a test went through, with a verdict: `evidence`, `facts`, `criteria`, then `page`."""
