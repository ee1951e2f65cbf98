"""What a double consists of: boards, scopes, and how a test describes them."""
