"""Work between sets: each piece runs while nothing is due, and its trouble costs no set."""
