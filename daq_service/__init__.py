"""Runs the rig: all that has a clock, a disk, a process or a person; no physics, no statistics."""
