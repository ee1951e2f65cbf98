"""``solimon doctor``: check whether everything is ready for a test, and list remedies.

Checks switch, strike and write nothing except a probe file in the data folder. Only `trial` strikes, and
only when a person asks for it.
"""
