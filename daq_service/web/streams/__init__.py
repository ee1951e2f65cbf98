"""Streams: events for many clients, and live figures of shots."""
