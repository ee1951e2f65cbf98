"""The journal: every shot durable a moment after it was struck; whole sets leave it for their own files.

`frames` is the format, `writer` appends and syncs, `reader` finds again what a crash has left.
"""
