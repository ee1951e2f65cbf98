"""Thickness from ultrasonic echoes. What enters: methods that read a pulse-echo record."""
