"""Opens a rig: the only place that chooses between boards, twin, doubles and recorded shots."""
