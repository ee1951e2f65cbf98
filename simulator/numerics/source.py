"""Digest of the twin's own source: cached arrays belong to one state of the code."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path


@cache
def hash_source() -> str:
    """Return the SHA-256 (hex) of every module of the simulator except the doubles, which compute no shot.

    Line ends do not count: an installed wheel and a checkout on Windows have the same digest.
    """
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for name in sorted(path.relative_to(package).as_posix() for path in package.rglob("*.py")):
        if not name.startswith("doubles/"):
            content = (package / name).read_bytes().replace(b"\r\n", b"\n")
            digest.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()
