"""The widest printable page, that of a reproduction, fits the paper and a phone, and is accessible."""

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import DESK, PHONE

from daq_service.cli.reproduce.comparison import AGREEMENTS, NOT_AVAILABLE, compare_item
from daq_service.cli.reproduce.item import make_value
from daq_service.cli.reproduce.items import ITEMS
from daq_service.cli.reproduce.outcome import Section
from daq_service.cli.reproduce.paper_values import list_paper_values
from daq_service.cli.reproduce.summary import assess_claims, count_values
from daq_service.web.templates import render_template

pytestmark = pytest.mark.browser

A4_PX = 688
"""Width between the margins of the style: 182 mm at 96 pixels an inch."""
A4_HEIGHT_PX = 1001
"""Height between them: 265 mm."""


def test_the_page_of_a_reproduction_is_cut_nowhere(open_page, tmp_path):
    file = tmp_path / "report.html"
    found = {
        item.name: {value.quantity: make_value(1.04 * (value.value or 1.0)) for value in values}
        for item in ITEMS
        if (values := list_paper_values(item.name))
    }
    sections = [
        Section(item=item, rows=compare_item(item.name, found.get(item.name, {}), origin="shipped"))
        for item in ITEMS
    ]
    rows = [row for section in sections for row in section.rows]
    file.write_bytes(
        render_template(
            "reproduction.html.j2",
            title="Reproduction",
            run_facts={"configuration": "0123456789abcdef" * 4},
            origin="shipped",
            missing=[],
            counts=count_values(rows),
            claims=assess_claims(rows),
            sections=sections,
            agreements=AGREEMENTS,
            not_available=NOT_AVAILABLE,
        )
    )
    page = open_page(file.as_uri())
    for media, width in (("screen", PHONE["width"]), ("screen", DESK["width"]), ("print", A4_PX)):
        page.emulate_media(media=media)
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, (media, width)
    # The last width is that of the paper: the summary is its first page, and nothing else is.
    appendix = page.locator(".appendix")
    assert 0.5 * A4_HEIGHT_PX < appendix.bounding_box()["y"] < A4_HEIGHT_PX
    assert appendix.evaluate("heading => getComputedStyle(heading).breakBefore") == "page"
    page.emulate_media(media="screen")
    violations = Axe().run(page)
    assert violations.violations_count == 0, violations.generate_report()
