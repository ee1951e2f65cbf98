"""The three-dimensional plate of high order. Unaware of the thin one."""
