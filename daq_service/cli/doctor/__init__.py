"""``solimon doctor``: is everything ready for a test, and if not, what is to be done.

Each check looks and tells; nothing is switched, struck or written but a probe file in the data folder.
`trial` alone strikes, and only when a person asks for it.
"""
