"""``solimon simulate --sweep``: shots over any parameters, restartable, in tables for other programs."""
