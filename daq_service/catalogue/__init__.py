"""The catalogue: what was taken, what it says, what was decided; SQLite through SQLAlchemy Core."""
