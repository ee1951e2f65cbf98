"""Figures of the docs and screens of the page, of a test on the twin: real commands, headless Chromium.

``python -m support.pictures [FOLDER]`` in ``tests/`` writes the figures where the docs show them, or to
another folder; ``python -m support.pictures --screens FOLDER`` writes the screens for a review of the page.
The twin's test is seeded and goes on in one folder from hour to hour. A picture is taken once it shows what
it is taken for, and carries that text with it. Which strike the live waveform shows is a matter of time: it
is shown ten times a second at most, and here hours take seconds.
"""

from __future__ import annotations

import io
import re
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import httpx2

from daq_service.processes.data_folder import CONFIGURATION_FILE
from daq_service.settings.file import load_settings
from support.browser_pages import DESK, PHONE, chromium, expect
from support.pseudo_terminal import on_terminal
from support.served_web import DEADLINE_S, served

DOCS = Path(__file__).parents[2] / "docs"
SOLIMON = [sys.executable, "-m", "daq_service.cli"]
DEMO = "demo --exit --no-web --hours 12 --data-dir corrosion-test"
"""What begins the test, as the tutorial has it."""
CHARTS = {"#tof": "tof_pp_s", "#distance": "distance_squared", "#amplitude-ratio": "amplitude_ratio"}
"""Charts of the page, and the column of the API that each draws."""
COLOURS = 64
"""Of a picture's palette: edges of letters and lines keep their shades, a file is a third as large."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """One figure of the documentation.

    Attributes
    ----------
    file
        Where the docs keep it.
    hour
        How far the test is then.
    of
        Part of the page as a CSS selector (``body``: all of it, ``screen``: what a window shows), or the
        command whose terminal it is.
    shows
        Texts that stand in it: it is not taken before, and they are written into the file.
    position
        Which tile is chosen on the page.
    view
        Query of the page's address.
    press
        Element that is clicked before, as a CSS selector.
    phone
        Whether the window is that of a phone.
    """

    file: str
    hour: int
    of: str
    shows: Sequence[str]
    position: str = "B"
    view: str = ""
    press: str = ""
    phone: bool = False


LISTS = {
    name: tuple(Picture(**one) for one in listed)
    for name, listed in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items()
}
PICTURES = LISTS["pictures"]


def parsed_line(path: Path) -> str:
    """Return the source line in the file of a figure."""
    if path.suffix == ".svg":
        return ElementTree.parse(path).findtext("{http://www.w3.org/2000/svg}desc", default="")
    from PIL import Image

    with Image.open(path) as image:
        return str(image.info.get("Description", ""))


def source_of(picture: Picture) -> str:
    """Return the source line for the file of a figure."""
    return f"hour {picture.hour}, {picture.of}: {'; '.join(picture.shows)}"


def make(folder: Path, pictures: Sequence[Picture] = PICTURES) -> None:
    """Record the test and write each figure below ``folder``."""
    with tempfile.TemporaryDirectory() as place, chromium() as browser:
        *demo, name = DEMO.split()
        data = Path(place) / name
        began = _on_terminal(*demo, str(data))
        for picture in sorted(pictures, key=lambda picture: picture.hour):
            # Does nothing where the test is there already.
            its = str(data / CONFIGURATION_FILE)
            if picture.hour:
                _on_terminal(
                    "record", its, "--data-dir", str(data), SOLIMON_SCHEDULE__END_H=str(picture.hour)
                )
            path = folder / picture.file
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix in {".png", ".pdf"}:
                with _page(browser, data, picture) as (page, api):
                    taken = _taken(page, api, picture)
                    path.write_bytes(
                        page.pdf(format="A4")
                        if path.suffix == ".pdf"
                        else compress_picture(taken, source_of(picture))
                    )
            else:
                screen = began if picture.of == "demo" else _on_terminal(picture.of, "--data-dir", str(data))
                path.write_text(_drawn(screen.replace(place, "~"), picture), encoding="utf-8", newline="\n")
            print(f"hour {picture.hour}: {path}", flush=True)


def _on_terminal(*words: str, **environment: str) -> str:
    """Run a command to its end; return its screen, with colors where nothing was overwritten."""
    with on_terminal([*SOLIMON, *words], environment) as terminal:
        assert terminal.end() == 0, terminal.written
        plain = "\n".join(terminal.shown())
        return plain if re.search(r"\x1b\[[\d;]*[^m\d;]", terminal.written) else terminal.written


@contextmanager
def _page(browser: Any, data: Path, picture: Picture) -> Iterator[tuple[Any, httpx2.Client]]:
    """Open the page of the test in its present state, at hour 0 without any data."""
    hours = {"schedule": {"end_h": picture.hour}} if picture.hour else {}
    settings = load_settings(data / CONFIGURATION_FILE, overrides=hours)
    with (
        tempfile.TemporaryDirectory() as empty,
        served(settings, data if picture.hour else Path(empty)) as service,
    ):
        context = browser.new_context(viewport=PHONE if picture.phone else DESK, color_scheme="light")
        page = context.new_page()
        page.set_default_timeout(1000 * DEADLINE_S)
        page.goto(f"{service.url}{picture.view}")
        with service.client() as api:
            yield page, api
        context.close()


def _taken(page: Any, api: httpx2.Client, picture: Picture) -> bytes:
    if picture.hour:
        _wait_for_charts(page, api, picture)
    if picture.press:
        page.locator(picture.press).first.click()
    whole_page, screen = picture.of == "body", picture.of == "screen"
    part = page.locator("body" if screen else picture.of)
    for text in picture.shows:
        expect(part).to_contain_text(text)
    return bytes(page.screenshot(full_page=whole_page) if whole_page or screen else part.screenshot())


def _wait_for_charts(page: Any, api: httpx2.Client, picture: Picture) -> None:
    # As the page asks: of all columns so many sets would come in bins.
    asked = {"points": 1000, "fields": ",".join(CHARTS.values())}
    trend = api.get(f"/api/v1/trends/{picture.position}", params=asked).json()["columns"]
    if not picture.view:
        page.locator(f'#tiles [data-position="{picture.position}"]').click()
    expect(page.locator("#waveform")).to_have_attribute("data-sequence", re.compile(r"\d+"))
    for chart, column in CHARTS.items():
        points = sum(value is not None for value in trend[column])
        expect(page.locator(chart)).to_have_attribute("data-points", str(points))
    expect(page.locator("#waterfall")).to_have_attribute("data-drawn", re.compile(r"[1-9]"))
    expect(page.locator("#waterfall")).not_to_contain_text("sets are loading")


def compress_picture(png: bytes, description: str) -> bytes:
    """Return a PNG with a palette of `COLOURS` and a description."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    notes, smaller = PngInfo(), io.BytesIO()
    notes.add_text("Description", description)
    with Image.open(io.BytesIO(png)) as image:
        few = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(smaller, "PNG", optimize=True, pnginfo=notes)
    return smaller.getvalue()


def _drawn(screen: str, picture: Picture) -> str:
    """Draw the screen of a terminal; the page that shows it loads no remote font."""
    from rich.console import Console
    from rich.text import Text

    text = Text.from_ansi(screen.replace("\r\n", "\n").rstrip())
    for wanted in picture.shows:
        assert wanted in text.plain, f"{picture.file}: no {wanted!r} in {text.plain}"
    width = max(map(len, text.plain.splitlines()))
    console = Console(record=True, width=width, file=io.StringIO(), force_terminal=True)
    console.print(text)
    svg = re.sub(r"@font-face \{[^}]*\}", "", console.export_svg(title=f"solimon {picture.of}"))
    description = f"<desc>{escape(source_of(picture))}</desc>"
    return re.sub(r"(<svg [^>]*>)", lambda found: found[1] + description, svg, count=1)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--screens"]:
        make(Path(sys.argv[2]), LISTS["screens"])
    else:
        make(Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS)
