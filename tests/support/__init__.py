"""What tests share: rigs, brains, folders and records made for them."""
