"""Wall loss from solitary waves: the bank of simulated curves, and what a set knows about the wall."""
