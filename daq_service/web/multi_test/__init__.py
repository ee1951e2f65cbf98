"""Several tests in one service: each opened when somebody asks for it, a list of all, one set of doors."""
