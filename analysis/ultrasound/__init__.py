"""Thickness from ultrasonic echoes: methods that evaluate a pulse-echo record."""
