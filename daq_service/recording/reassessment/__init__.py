"""Reassess stored sets: rebuild a catalogue, replay a test with other settings, explain an alarm."""
