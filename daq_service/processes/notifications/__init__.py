"""Tells people and programs elsewhere of alarms; a receiver that is dead slows nothing."""
