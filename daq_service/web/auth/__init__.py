"""Who may come in and do what: tokens, roles, what is refused before a route is reached."""
