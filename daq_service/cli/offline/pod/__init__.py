"""``solimon pod``: probability of detection from tests on the twin and from tables."""
