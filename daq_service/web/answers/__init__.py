"""Shapes of what the service answers: JSON, pages, problem details. No route, no SQL."""
