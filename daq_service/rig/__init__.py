"""Opens a rig of whatever kinds of instruments; the twin, doubles and recorded shots as such kinds."""
