"""What keeps a data folder whole: `verify` looks, `repair` mends what needs no guess, `backup` copies."""
