"""A numerical specimen behind the same instruments as a real rig. Knows no storage, web or analysis."""
