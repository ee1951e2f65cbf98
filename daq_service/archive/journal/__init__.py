"""The journal: makes every shot durable within moments; complete sets move to their own files.

`frames` is the format, `writer` appends and syncs, `reader` recovers sets after a crash.
"""
