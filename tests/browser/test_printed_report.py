"""The PDF of a report has its summary on two pages, and that of an alarm its finding on the first."""

import json

import pytest
from axe_playwright_python.sync_playwright import Axe
from click.testing import CliRunner
from pypdf import PdfReader
from support.browser_pages import DESK, PHONE, find_browser
from support.drifting_wall import drifting_wall
from support.filled_folder import filled_folder, frozen_baseline

from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import AlarmRow
from daq_service.cli.main import cli
from daq_service.settings.tree import Settings
from daq_service.web.report import pdf
from daq_service.web.report.make import build_report_page

pytestmark = pytest.mark.browser

A4_PT = (595, 842)
A4_PX = 688
"""Width between the margins of the style: 182 mm at 96 pixels an inch."""
NOTE = "<b>couplant</b> renewed"


LABEL = "transducer with a long name, 25.4 mm patch, weld 14 west"
WALL = {"diagnosis": "wall", "diagnosis_probability": 0.97}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """Yield a test with more positions and alarms than a summary shows, and long texts."""
    methods = {"A": "pulse_echo", **dict.fromkeys("BCDEFGH", "solitary_wave")}
    place = {"label": LABEL, "serial_number": "SN-0012345"}
    settings = Settings(positions={name: {**place, "method": method} for name, method in methods.items()})
    quality = {"n": 48, "false_alarms_per_sensor_year": 0.2, "rate_verified": False}
    with filled_folder(tmp_path_factory.mktemp("data"), settings, sets=52) as folder:
        rows = [frozen_baseline(name, baseline_quality=quality) for name in methods]
        folder.catalogue.commit_set(SetCommit(baselines=rows))
        for position in methods:
            for index, kind, priority in ((49, "wall_change", "high"), (51, "no_reflection", "critical")):
                folder.add_alarm(position, index, kind=kind, priority=priority, evidence=WALL)
        folder.annotate(3.0, NOTE, position="B")
        yield folder


def read_pages(command, target, monkeypatch):
    monkeypatch.setattr(pdf, "BROWSERS", (find_browser(),))
    done = CliRunner().invoke(cli, [*map(str, command), "--pdf", "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    pages = PdfReader(target).pages
    for page in pages:
        assert [float(size) for size in page.mediabox[2:]] == pytest.approx(A4_PT, abs=1)
    return json.loads(done.stdout), [" ".join(page.extract_text().split()) for page in pages]


def test_a_report_is_cut_nowhere_and_accessible(open_page, filled, tmp_path):
    file = tmp_path / "report.html"
    file.write_bytes(build_report_page(filled.folder, audited=True))
    page = open_page(file.as_uri(), name=None)
    for media, width in (("screen", PHONE["width"]), ("screen", DESK["width"]), ("print", A4_PX)):
        page.emulate_media(media=media)
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, (media, width)
    page.emulate_media(media="screen")
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()


def test_a_report_has_its_summary_on_two_pages(browser, filled, tmp_path, monkeypatch):
    target = tmp_path / "report.pdf"
    answer, pages = read_pages(("report", filled.folder, "--out", target), target, monkeypatch)
    assert answer == {"ok": True, "file": str(target), "n_bytes": target.stat().st_size}
    assert list(tmp_path.iterdir()) == [target]
    summary = " ".join(pages[:2])
    for heading in ("Findings by position", "Active alarms and actions", "Reliability of the findings"):
        assert f" {heading} " in summary
    # Both of each of 6 positions; the table has 6, the most urgent, and the first is on top.
    assert summary.count("signal change, probable wall thinning (model: 97 %)") == 6
    assert summary.count("no reflected wave, possible hole or lost contact") == 6 + 6 + 1
    assert "10 further alarms are in the appendix." in summary
    assert summary.count("not verified: 48 sets, 150 needed") == 5, "one is a probe"
    assert summary.endswith("(ultrasound.delay_s) makes the wall loss more accurate.")
    assert "Appendix Identity" in pages[2], "the summary ends with the second page"
    assert NOTE in " ".join(pages[2:])
    assert all(f"Page {number} of {len(pages)}" in page for number, page in enumerate(pages, start=1))


def test_an_explained_alarm_has_finding_and_guidance_on_its_first_page(browser, tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    line = drifting_wall(tmp_path / "data")
    with line.catalogue() as catalogue:
        alarm = next(row for row in catalogue.rows(AlarmRow) if row.position == "B")
    out, target = tmp_path / "out", tmp_path / f"out/alarm-{alarm.id}.pdf"
    command = ("explain", alarm.id, "--data-dir", line.folder, "--out", out)
    answer, pages = read_pages(command, target, monkeypatch)
    assert sorted(answer["files"]) == sorted(map(str, out.iterdir()))
    assert alarm.message[1:] in pages[0]
    for heading in ("Finding", "Guidance", "Figures"):
        assert f" {heading} " in pages[0]
