"""Three-dimensional plate of high order. Independent of the thin one."""
