"""Ultrasonic echo: far wall, pulse, records. Nothing of solitary waves."""
