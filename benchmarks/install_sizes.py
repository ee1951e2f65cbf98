"""Size of an installation without extras, with the client and with the demonstration.

    python benchmarks/install_sizes.py

Each is installed with the versions of ``constraints.txt`` into an empty environment without pip. The size is
that of its site-packages on disk (``du``), with compiled Python files, in 1e6 bytes. Exit code 1: the
installation without extras is above its limit. Needs a package index.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = {"base": "", "client": "[client]", "demo": "[demo]"}
MOST_BASE_MB = 380.0


def size_bytes(folder: Path) -> int:
    """Return the space on disk of all files of a folder."""
    return sum(
        getattr(status, "st_blocks", -(-status.st_size // 4096) * 8) * 512  # Windows does not count blocks
        for status in (path.stat() for path in folder.rglob("*") if path.is_file())
    )


def installed_mb(extra: str, folder: Path) -> float:
    """Install solimon with an extra into a new environment and return the size of its site-packages."""
    venv.create(folder, with_pip=False)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--compile"]
    subprocess.run([*install, "-c", str(ROOT / "constraints.txt"), f"{ROOT}{extra}"], check=True)
    (site,) = (path for path in folder.rglob("site-packages") if path.is_dir())
    return size_bytes(site) / 1e6


def main() -> None:
    found = {}
    for name, extra in EXTRAS.items():
        with tempfile.TemporaryDirectory(prefix="solimon-size-") as folder:
            found[name] = round(installed_mb(extra, Path(folder)), 1)
            print(f"{name:8}{found[name]:7.1f} MB", file=sys.stderr)
    print(json.dumps({"most_base_mb": MOST_BASE_MB, "size_mb": found}))
    sys.exit(found["base"] > MOST_BASE_MB)


if __name__ == "__main__":
    main()
