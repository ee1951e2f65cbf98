"""Processes that share a data folder: supervisor and child, heartbeat, lock. Nothing of shots."""
