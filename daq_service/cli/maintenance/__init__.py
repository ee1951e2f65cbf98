"""Maintain a data folder: `verify` checks, `repair` repairs what is unambiguous, `backup` copies."""
