"""Pages of other origins: refused by default, and a configured origin may embed a panel and read."""

import pytest
from pydantic import ValidationError
from starlette.datastructures import Headers
from support.filled_folder import filled_folder
from support.served_web import served

from daq_service.settings.tree import Settings
from daq_service.settings.web import WebSettings
from daq_service.web.auth.tokens import create_token
from daq_service.web.embedding import Embedding

WIKI, OTHER = "https://wiki.example.org", "https://other.example.org"
PANEL = "/?position=B&panel=tof&embed=1"
ACROSS = {"Origin": WIKI, "Sec-Fetch-Site": "cross-site"}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    web = {"embed_origins": [WIKI, "http://localhost:3000"]}
    with filled_folder(tmp_path_factory.mktemp("embedded"), Settings(web=web), sets=2) as folder:
        yield folder


def ancestors(answer):
    """Return the value of frame-ancestors in the policy of an answer."""
    (found,) = [
        part.partition("frame-ancestors ")[2]
        for part in answer.headers["content-security-policy"].split("; ")
        if part.startswith("frame-ancestors")
    ]
    return found


def test_only_the_embedded_page_may_be_framed_and_only_by_the_configured_origins(api):
    panel = api.get(PANEL, headers={"Sec-Fetch-Site": "cross-site"})
    assert panel.status_code == 200
    assert ancestors(panel) == f"http://localhost:3000 {WIKI}"
    assert "x-frame-options" not in panel.headers
    assert panel.headers["cross-origin-resource-policy"] == "cross-origin"
    for path in (
        "/",
        "/?embed=0",
        "/?panel=tof",
        "/api/v1/info?embed=1",
        "/docs/?embed=1",
        "/static/main.js",
    ):
        answer = api.get(path)
        assert ancestors(answer) == "'none'", path
        assert answer.headers["x-frame-options"] == "DENY", path
        assert answer.headers["cross-origin-resource-policy"] == "same-origin", path


def test_a_configured_origin_reads_and_never_writes_or_streams(api):
    answer = api.get("/api/v1/trends/B", headers=ACROSS)
    assert answer.status_code == 200
    assert answer.headers["access-control-allow-origin"] == WIKI
    assert answer.headers["cross-origin-resource-policy"] == "cross-origin"
    assert "Origin" in answer.headers["vary"]
    assert "access-control-allow-origin" not in api.get("/api/v1/info").headers
    foreign = api.get("/api/v1/info", headers=ACROSS | {"Origin": OTHER})
    assert (foreign.status_code, foreign.json()["type"].rpartition(":")[2]) == (403, "foreign-origin")
    assert "access-control-allow-origin" not in foreign.headers
    assert api.post("/api/v1/commands", headers=ACROSS, json={"kind": "stop"}).status_code == 403
    assert api.get("/api/v1/stream", headers=ACROSS).status_code == 403


def test_without_configuration_nothing_is_embedded_or_read(filled):
    with served(Settings(), filled.folder) as service, service.client() as api:
        panel = api.get(PANEL)
        assert ancestors(panel) == "'none'"
        assert panel.headers["x-frame-options"] == "DENY"
        answer = api.get("/api/v1/info", headers=ACROSS)
        assert (answer.status_code, "access-control-allow-origin" in answer.headers) == (403, False)
        assert "Origin" not in api.get("/api/v1/info").headers.get("vary", "")


def test_with_tokens_another_site_is_refused_with_the_reason(filled, tmp_path):
    tokens = tmp_path / "tokens.json"
    _, text = create_token(tokens, "ann", "viewer")
    web = filled.settings.web.model_copy(update={"tokens_file": str(tokens)})
    settings = filled.settings.model_copy(update={"web": web})
    with served(settings, filled.folder) as service, service.client() as api:
        for path in (PANEL, "/api/v1/info"):
            refused = api.get(path, headers=ACROSS)
            assert (refused.status_code, refused.json()["type"]) == (
                403,
                "urn:solimon:problem:cross-site-embedding",
            )
            assert "the same site" in refused.json()["hint"]
        assert ancestors(api.get(PANEL, headers=ACROSS)) == f"http://localhost:3000 {WIKI}", (
            "it is shown there"
        )
        same_site = {"Origin": WIKI, "Sec-Fetch-Site": "same-site"}
        assert api.get(PANEL, headers=same_site).status_code == 200
        assert api.get("/api/v1/info", headers=same_site).status_code == 401
        known = same_site | {"Authorization": f"Bearer {text}"}
        answer = api.get("/api/v1/info", headers=known)
        assert (answer.status_code, answer.headers["access-control-allow-credentials"]) == (200, "true")


@pytest.mark.parametrize(
    "origin",
    ["*", "null", "wiki.example.org", "https://wiki.example.org/", "https://a b", "https://*.example.org"],
)
def test_an_origin_is_a_scheme_and_a_host(origin):
    with pytest.raises(ValidationError, match="embed_origins"):
        WebSettings(embed_origins=[origin])


def test_embedding_is_no_part_of_the_identity_of_a_test(filled):
    assert filled.settings.configuration_hash() == Settings().configuration_hash()


@pytest.mark.parametrize(
    ("path", "query", "is_embedded"),
    [
        ("/tests/tank-3/", b"embed=1&panel=tof", True),
        ("/tests/tank-3/", b"embed=0", False),
        ("/tests/tank-3/api/v1/info", b"embed=1", False),
        ("/tests/", b"embed=1", False),
    ],
)
def test_a_service_of_several_tests_embeds_the_dashboard_of_each(path, query, is_embedded):
    scope = {"type": "http", "method": "GET", "path": path, "query_string": query}
    chosen = Embedding(frozenset({WIKI})).choose_headers(scope, Headers({}))
    assert (chosen["Content-Security-Policy"].endswith(f"frame-ancestors {WIKI}")) == is_embedded
