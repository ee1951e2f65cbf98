"""Print an HTML page to PDF by a browser of this computer: Chromium, Chrome or Edge."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from daq_service.errors import UsageError

BROWSERS = (
    *("chromium-headless-shell", "chromium", "chromium-browser"),
    *("google-chrome", "google-chrome-stable", "chrome", "microsoft-edge", "msedge"),
)
"""Names on the search path."""
PROGRAMS = ("Microsoft/Edge/Application/msedge.exe", "Google/Chrome/Application/chrome.exe")
"""Paths in the program folders of Windows, which are not on its search path."""
TIMEOUT_S = 120.0
REMEDY = "leave out --pdf and print the HTML page from a browser"


def find_browser() -> str:
    """Return the path of a browser that prints pages without a window; raise UsageError without one."""
    folders = filter(None, map(os.environ.get, ("ProgramFiles(x86)", "ProgramFiles", "LocalAppData")))
    programs = [str(Path(folder, program)) for folder in folders for program in PROGRAMS]
    found = next(filter(None, map(shutil.which, (*BROWSERS, *programs))), None)
    if found is None:
        raise UsageError(f"--pdf needs Chromium, Chrome or Edge; none was found. Install one, or {REMEDY}.")
    return found


def print_page(page: bytes, target: Path) -> bytes:
    """Print an HTML page in UTF-8 and return the PDF for the file ``target``; it takes seconds.

    A temporary folder next to ``target`` is used. Raise UsageError if there is no browser, or if it does not
    print.
    """
    browser, content, reason = find_browser(), b"", ""
    # A profile of its own: a browser that runs already would take over and print nothing.
    options = ["--headless", "--disable-gpu", "--no-first-run", "--no-pdf-header-footer"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--no-sandbox")  # Chromium refuses to start as root with it; the page has no scripts.
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        # A browser that is confined by the system (snap) reads neither /tmp nor hidden folders.
        with TemporaryDirectory(prefix="solimon-pdf-", dir=target.parent, ignore_cleanup_errors=True) as name:
            source, printed, profile = (
                Path(name, item).absolute() for item in ("page.html", "page.pdf", ".")
            )
            source.write_bytes(page)
            options += [f"--user-data-dir={profile}", f"--print-to-pdf={printed}", source.as_uri()]
            done = subprocess.run([browser, *options], capture_output=True, timeout=TIMEOUT_S, check=False)
            reason = f"exit code {done.returncode}, {done.stderr.decode(errors='replace')[-200:].strip()!r}"
            content = printed.read_bytes()
    except (OSError, subprocess.TimeoutExpired) as error:
        reason = reason or str(error)
    if not content.startswith(b"%PDF-"):
        raise UsageError(f"{browser} did not print the page: {reason}. To continue, {REMEDY}.")
    return content
