"""Zener's impact on a large plate, and the paper's table 2 from it. No finite plate."""
