"""Thickness from ultrasonic echoes."""
