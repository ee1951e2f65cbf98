"""Components of a double: boards, scopes, and their description."""
