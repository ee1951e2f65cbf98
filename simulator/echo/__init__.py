"""The ultrasonic echo: far wall, pulse, records."""
