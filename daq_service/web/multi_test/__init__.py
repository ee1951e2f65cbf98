"""Service of several tests: each opened on request, a list of all, one authentication."""
