"""Files of the dashboard: unchanged, local only, under a strict content policy."""

import posixpath
import re
from typing import get_args

import httpx2
import pytest
from support.served_web import brought, served

from daq_service.assessment.position_status import PositionStatus
from daq_service.settings.tree import Settings
from daq_service.web.assets import FOLDER, load_assets

PRELOADED = re.compile(rb'<link rel="modulepreload" href="/static/([^"]+)">')
OF_OTHER_PAGES = {"setup.js", "tests.js", "events/worker.js"}
"""Begun by a page itself, or by a worker."""
TEXT = {name: asset.content.decode() for name, asset in load_assets().items()}
OURS = [name for name in TEXT if not name.startswith("vendor/") and name != "LICENSE"]


@pytest.fixture(scope="module")
def api(tmp_path_factory):
    with served(Settings(), tmp_path_factory.mktemp("empty")) as service, service.client() as client:
        yield client


def test_page_is_served_without_any_data(api):
    page = api.get("/")
    assert page.status_code == 200
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert brought(page.text).keys() == {"/api/v1/session"}
    assert re.sub(r'(id="answers">).*(</script>)', r"\1{}\2", page.text) == TEXT["index.html"]


@pytest.mark.parametrize("name", sorted(TEXT))
def test_every_file_is_served_with_its_type(api, name):
    answer = api.get(f"/static/{name}")
    assert answer.status_code == 200
    assert PRELOADED.sub(b"", answer.content) == (FOLDER / name).read_bytes()
    kind = {"js": "text/javascript", "css": "text/css", "html": "text/html", "svg": "image/svg+xml"}
    assert answer.headers["content-type"].startswith(kind.get(name.rpartition(".")[2], "text/plain"))


@pytest.mark.parametrize(
    "path",
    [
        "../tokens.json",
        "%2e%2e/tokens.json",
        "..%2f..%2ftokens.json",
        "..%5c..%5ctokens.json",
        "/etc/passwd",
        "%2fetc%2fpasswd",
        "main.js%00.css",
        "NUL",
        "con.js",
        "C:%5ctokens.json",
    ],
)
def test_no_path_escapes_the_files_of_the_page(api, path):
    answer = api.get(httpx2.URL(f"{api.base_url}static/{path}"))
    assert answer.status_code in {400, 404}


def test_the_page_names_every_module_that_it_needs_at_once():
    first, later = load_assets()["index.html"].content.split(b'<template id="later">')
    names = [name.decode() for name in PRELOADED.findall(first + later)]
    assert len(names) == len(set(names))
    assert len(PRELOADED.findall(first)) < 10, "what the tiles need, and no more"
    assert set(names) == {name for name in TEXT if name.endswith(".js")} - OF_OTHER_PAGES


@pytest.mark.parametrize("accepted", ["gzip, br", "identity"])
def test_a_file_is_compressed_for_clients_that_accept_it(api, accepted):
    answer = api.get("/static/main.js", headers={"Accept-Encoding": accepted})
    assert answer.headers.get("content-encoding") == ("gzip" if "gzip" in accepted else None)
    assert answer.headers["vary"] == "Accept-Encoding"
    assert answer.text == TEXT["main.js"]


def test_browser_revalidates_by_etag(api):
    first = api.get("/static/main.js")
    assert first.headers["cache-control"] == "no-cache"
    again = api.get("/static/main.js", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def test_page_has_nothing_that_its_policy_forbids():
    page = TEXT["index.html"]
    # Data are no script and are not executed.
    assert not re.search(r'<script(?![^>]*(?:\bsrc=|type="application/json"))', page)
    assert not re.search(r"<style|\sstyle=|\son\w+=", page)
    for name in OURS:
        assert 'setAttribute("style"' not in TEXT[name]
        assert "innerHTML" not in TEXT[name]


def test_the_page_loads_no_external_resource():
    for name in OURS:
        links = re.findall(r"https?://[^\s\"'`)]+", TEXT[name])
        # The namespace of SVG is a name, not an address.
        assert set(links) <= {"http://www.w3.org/2000/svg"}, name


def test_the_page_has_a_label_for_each_status_of_a_position():
    states = TEXT["icons.js"].partition("export const STATES = {")[2].partition("};")[0]
    labels = dict(re.findall(r'(\w+): \{ label: "([^"]+)"', states))
    assert labels.keys() == set(get_args(PositionStatus))
    assert (labels["shelved"], labels["out_of_service"]) == ("Shelved", "Out of service")


def test_every_reference_is_a_file():
    for reference in re.findall(r'(?:href|src)="/static/([^"]+)"', TEXT["index.html"]):
        assert reference in TEXT
    for name in OURS:
        if name.endswith(".js"):
            for reference in re.findall(r'(?:from |new URL\()"(\.{1,2}/[^"]+)"', TEXT[name]):
                assert posixpath.normpath(posixpath.join(posixpath.dirname(name), reference)) in TEXT, (
                    name,
                    reference,
                )


def test_vendored_chart_library_carries_its_licence_and_version():
    assert "uPlot.js" in TEXT["vendor/uplot/uPlot.esm.js"]
    assert "v1.6.32" in TEXT["vendor/uplot/uPlot.esm.js"]
    assert "MIT License" in TEXT["vendor/uplot/LICENSE"]
    assert "sourceMappingURL" not in TEXT["vendor/uplot/uPlot.esm.js"]
