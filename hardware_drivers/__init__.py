"""Measurements, and the instruments that make them.

`measurement` and `instruments` are the vocabulary that every other package speaks; `errors` is
what an instrument may raise. Vendor drivers live in folders of their own and are imported only
when a rig needs them.
"""
