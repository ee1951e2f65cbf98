"""Authentication and authorization: tokens, roles, and the middleware before the routes."""
