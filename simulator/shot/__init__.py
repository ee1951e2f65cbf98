"""Strike: time integration of chain and plate together."""
