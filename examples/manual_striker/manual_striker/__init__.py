"""Strikers of solimon that need no NI counter: a person, and a relay board."""
