"""One set: when it is due, how its strikes are taken, what was taken. No file, no verdict."""
