"""A browser of the computer prints a page to PDF; without one the error names the remedy."""

import stat
import sys

import pytest

from daq_service.errors import UsageError
from daq_service.web.report import pdf

REMEDY = "print the HTML page from a browser"


def test_a_browser_in_a_program_folder_is_found_and_without_one_the_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    for name in ("ProgramFiles(x86)", "ProgramFiles", "LocalAppData"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(UsageError, match=f"needs Chromium, Chrome or Edge; none was found.*{REMEDY}"):
        pdf.print_page(b"", tmp_path / "page.pdf")
    edge = tmp_path / "Microsoft" / "Edge" / "Application" / "msedge.exe"
    edge.parent.mkdir(parents=True)
    edge.touch(mode=stat.S_IRWXU)
    monkeypatch.setenv("ProgramFiles(x86)", str(tmp_path))
    assert pdf.find_browser() == str(edge)


@pytest.mark.parametrize(
    ("program", "timeout_s", "reason"),
    [(sys.executable, 60.0, "exit code 2"), (sys.executable, 0.0, "timed out")],
)
def test_a_browser_that_prints_nothing_is_reported(program, timeout_s, reason, tmp_path, monkeypatch):
    monkeypatch.setattr(pdf, "BROWSERS", (program,))
    monkeypatch.setattr(pdf, "TIMEOUT_S", timeout_s)
    with pytest.raises(UsageError, match=f"did not print the page: .*{reason}.*{REMEDY}"):
        pdf.print_page(b"<p>page</p>", tmp_path / "out" / "page.pdf")
    assert list(tmp_path.glob("out/*")) == []


def test_a_folder_that_cannot_be_written_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(pdf, "BROWSERS", (sys.executable,))
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="did not print the page"):
        pdf.print_page(b"", tmp_path / "file" / "page.pdf")
