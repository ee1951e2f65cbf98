"""The documentation site, built by its generator in strict mode in a folder of the test."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
CONFIGURATION = "zensical.toml"


def build_site(folder: Path) -> Path:
    """Build the site from a copy of the documents and return its folder.

    Raises
    ------
    AssertionError
        The generator refuses a page: a link or an anchor leads nowhere. The message is the generator's.
    """
    shutil.copytree(ROOT / "docs", folder / "docs")
    text = (ROOT / CONFIGURATION).read_text(encoding="utf-8")
    changed = text.replace('site_dir = "daq_service/web/site"', 'site_dir = "site"')
    assert changed != text
    (folder / CONFIGURATION).write_text(changed, encoding="utf-8")
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "site"
