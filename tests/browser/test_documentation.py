"""The documentation at `/docs`: complete, offline, searchable, under a policy of its own."""

import base64
import hashlib
import json
import mimetypes
import re
from urllib.parse import unquote, urljoin, urlsplit

import pytest
from support.browser_pages import expect
from support.built_site import build_site
from support.served_web import served, served_app
from support.waiting import until

from daq_service.settings.tree import Settings
from daq_service.web import documentation
from daq_service.web.auth.tokens import create_token
from daq_service.web.multi_test.app import create_multi_test_app

HERE = "http://site/"
LOADED = re.compile(r'<(?:script|img|iframe|source)\b[^>]*?\ssrc="([^"]+)"|<link\b[^>]*?\shref="([^"]+)"')
LINKED = re.compile(r'<a\b[^>]*?\shref="([^"]+)"')
INLINE = re.compile(r"<script>(.*?)</script>", re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        built = build_site(tmp_path_factory.mktemp("documentation"))
        patch.setattr(documentation, "SITE", built)
        yield built


@pytest.fixture(scope="module")
def pages(site):
    """Return the text of each page by its path, without the page for unknown addresses of a host."""
    return {
        path.relative_to(site).as_posix().removesuffix("index.html"): path.read_text(encoding="utf-8")
        for path in site.rglob("index.html")
    }


@pytest.fixture(scope="module")
def service(site, tmp_path_factory):
    with served(Settings(), tmp_path_factory.mktemp("empty")) as running:
        yield running


@pytest.fixture(scope="module")
def api(service):
    with service.client() as client:
        yield client


def test_every_link_of_the_site_leads_to_a_file_of_it(site, pages):
    """Strict mode follows links between pages only: no pictures, no folders of the repository."""
    assert len(pages) > 50
    lost = [
        (path, target)
        for path, text in pages.items()
        for target in {*LINKED.findall(text), *(one or other for one, other in LOADED.findall(text))}
        if not is_there(site, path, target)
    ]
    assert lost == []


def is_there(site, path, target):
    """Return whether a link of a page leads to a file of the site, or to another host."""
    there = urlsplit(urljoin(HERE + path, target))
    if there.netloc != "site":
        return True
    file = site / unquote(there.path).lstrip("/")
    return (file / "index.html" if there.path.endswith("/") else file).is_file()


def test_no_page_loads_anything_from_another_host(site, pages):
    loaded = {one or other for text in pages.values() for one, other in LOADED.findall(text)}
    assert len(loaded) > 5
    assert {target for target in loaded if urlsplit(target).netloc} == set()
    styles = [path.read_text(encoding="utf-8") for path in site.rglob("*.css")]
    assert styles
    assert not any(re.search(r"@import|url\(['\"]?(?:https?:)?//", text) for text in styles)


def test_each_page_is_served_under_a_policy_with_the_hashes_of_its_scripts(api, pages):
    for path, text in pages.items():
        answer = api.get(f"/docs/{path}")
        assert (answer.status_code, answer.text) == (200, text)
        assert answer.headers["content-type"] == "text/html; charset=utf-8"
        policy = dict(
            part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";")
        )
        hashes = {
            base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in INLINE.findall(text)
        }
        assert hashes
        assert set(policy["script-src"].split()) == {"'self'", *(f"'sha256-{one}'" for one in hashes)}
        assert policy["default-src"] == "'none'"
        assert "unsafe" not in answer.headers["content-security-policy"]


def test_a_page_that_the_browser_has_keeps_its_policy(api):
    first = api.get("/docs/tutorial/")
    again = api.get("/docs/tutorial/", headers={"If-None-Match": first.headers["etag"]})
    assert again.status_code == 304
    assert again.headers["content-security-policy"] == first.headers["content-security-policy"]
    assert first.headers["cache-control"] == "no-cache"


def test_scripts_and_the_search_index_have_their_types_on_any_system(api, site, monkeypatch):
    """On Windows a program may have registered JavaScript as plain text, which no browser runs."""
    mimetypes.init()
    for suffix in (".js", ".json"):
        monkeypatch.setitem(mimetypes.types_map, suffix, "text/plain")
    index = api.get("/docs/search.json")
    assert index.headers["content-type"] == "application/json"
    assert any("Mahalanobis" in item["text"] for item in index.json()["items"])
    for script in site.rglob("*.js"):
        answer = api.get(f"/docs/{script.relative_to(site).as_posix()}")
        assert answer.headers["content-type"] == "text/javascript; charset=utf-8"


@pytest.mark.parametrize(
    "path",
    [
        *("nowhere/", "../documentation.py", "%2e%2e/docs/README.md", "..%2fzensical.toml"),
        *("..%5czensical.toml", "%2fetc%2fpasswd", "tutorial%00", "NUL", "assets/"),
    ],
)
def test_no_path_outside_of_the_site_is_served(api, path):
    answer = api.get(f"/docs/{path}")
    assert answer.status_code == 404
    assert answer.json()["type"] == "urn:solimon:problem:not-found"


def test_the_documentation_needs_no_token_where_the_interface_does(site, tmp_path):
    create_token(tmp_path / "tokens.json", "ann", "viewer", days=1.0)
    with served(Settings(), tmp_path) as service, service.client() as stranger:
        assert stranger.get("/api/v1/info").status_code == 401
        assert stranger.get("/docs/tutorial/").status_code == 200


def test_a_service_of_several_tests_has_it_at_its_root_and_below_each_test(site, tmp_path):
    folder = tmp_path / "plate"
    folder.mkdir()
    (folder / "catalogue.sqlite").touch()
    app = create_multi_test_app([folder], Settings(), tmp_path / "own")
    with served_app(app) as service, service.client() as client:
        assert client.get("/docs/tutorial/").status_code == 200
        assert client.get("/tests/plate/docs/tutorial/").status_code == 200


def test_without_a_built_site_the_answer_names_the_command_that_builds_it(tmp_path, monkeypatch):
    monkeypatch.setattr(documentation, "SITE", tmp_path / "site")
    with served(Settings(), tmp_path) as service, service.client() as client:
        answer = client.get("/docs/")
    assert answer.status_code == 404
    assert "`zensical build --strict`" in answer.json()["hint"]


@pytest.mark.browser
def test_the_search_finds_a_term_and_leads_to_its_page(service, open_page):
    page = open_page(f"{service.url}docs/tutorial/")
    page.wait_for_function("[...document.querySelectorAll('div')].some(one => one.shadowRoot)")
    search = page.locator("input:visible")

    def opens():  # a key that comes before the dialog listens is lost
        if not search.count():
            page.keyboard.press("Control+k")
            page.evaluate("new Promise(requestAnimationFrame)")
        return search.count()

    until(opens, "the dialog of the search")
    search.fill("Mahalanobis")
    result = page.locator("a", has_text="Glossary").filter(has_text="Mahalanobis")
    expect(result.first).to_be_visible()
    result.first.click()
    expect(page).to_have_url(re.compile("/docs/reference/glossary/"))


@pytest.mark.browser
def test_the_dashboard_leads_to_the_documentation_and_the_api_reference(service, open_page):
    page = open_page(service.url)
    link = page.get_by_role("link", name="Documentation")
    assert link.evaluate("link => link.href") == f"{service.url}docs/"
    page.get_by_role("link", name="API reference").click()
    expect(page.get_by_role("heading", name="REST API reference", level=1)).to_be_visible()


def test_the_description_of_the_interface_does_not_have_the_documentation(api):
    assert [
        path for path in json.loads(api.get("/api/v1/openapi.json").text)["paths"] if "docs" in path
    ] == []
