"""Digital twin: a numerical specimen behind the instruments of a real rig. No storage, web or analysis."""
