"""The widest printable page, that of a reproduction, fits the paper and a phone, and is accessible."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import DESK, PHONE

from daq_service.cli.reproduce.comparison import NOT_AVAILABLE, compare_item
from daq_service.cli.reproduce.items import ITEMS
from daq_service.cli.reproduce.outcome import Section
from daq_service.web.templates import render_template

pytestmark = pytest.mark.browser

A4_PX = 688
"""Width between the margins of the style: 182 mm at 96 pixels an inch."""


def test_the_page_of_a_reproduction_is_cut_nowhere(open_page, tmp_path):
    file = tmp_path / "report.html"
    file.write_bytes(
        render_template(
            "reproduction.html.j2",
            title="Reproduction",
            run_facts={"configuration": "0123456789abcdef" * 4},
            remarks=["Left the paper, right ours."],
            sections=[
                Section(item=item, rows=compare_item(item.name, {}, origin="shipped")) for item in ITEMS
            ],
            not_available=NOT_AVAILABLE,
        )
    )
    page = open_page(file.as_uri())
    for media, width in (("screen", PHONE["width"]), ("screen", DESK["width"]), ("print", A4_PX)):
        page.emulate_media(media=media)
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, (media, width)
    page.emulate_media(media="screen")
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
