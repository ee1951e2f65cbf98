"""The page of the dashboard embeds the first API responses for authorized users."""

import math

import pytest
from support.filled_folder import filled_folder
from support.served_web import brought, served

from daq_service.settings.tree import Settings
from daq_service.web.auth.tokens import create_token
from daq_service.web.routes import page

FIRST = ["/api/v1/session", "/healthz", "/api/v1/info", "/api/v1/transducers"]
LABEL = "</script><!-- <script>alert(1)</script> &lt; \u2028"
PLACES = {
    position: place.model_copy(update={"label": LABEL}) for position, place in Settings().positions.items()
}


@pytest.fixture
def filled(tmp_path):
    with filled_folder(tmp_path, Settings(positions=PLACES), sets=1) as folder:
        yield folder


def without_ages(data):
    """Remove the values that grow between two responses."""
    if isinstance(data, list):
        return [without_ages(item) for item in data]
    if not isinstance(data, dict):
        return data
    return {key: without_ages(value) for key, value in data.items() if key not in {"as_of", "age_h", "stale"}}


def test_the_page_embeds_api_responses_with_any_characters(filled):
    with served(filled.settings, filled.folder) as service, service.client() as api:
        answer = api.get("/")
        found = brought(answer.text)
        assert list(found) == FIRST
        for path in FIRST:
            assert without_ages(found[path]) == without_ages(api.get(path).json())
    assert found["/api/v1/info"]["positions"][0]["label"] == LABEL
    assert answer.text.count("</script>") == answer.text.count("<script ") == 2
    assert answer.headers["cache-control"] == "no-store"


def test_a_page_without_a_required_token_has_no_test_data(filled):
    _, text = create_token(filled.folder / "tokens.json", "ann", "viewer")
    with served(filled.settings, filled.folder) as service, service.client() as api:
        for headers in ({}, {"Authorization": "Bearer wrong"}):
            found = brought(api.get("/", headers=headers).text)
            assert found == {"/api/v1/session": {"token_needed": True, "name": None, "role": None, "may": []}}
        found = brought(api.get("/", headers={"Authorization": f"Bearer {text}"}).text)
        assert list(found) == FIRST
        assert found["/api/v1/session"]["name"] == "ann"


def test_pages_share_cached_responses(filled, monkeypatch):
    with served(filled.settings, filled.folder) as service, service.client() as api:
        kept_s = {"hour": math.inf, "moment": -1.0}

        def last_set(kept):
            monkeypatch.setattr(page, "KEPT_S", kept_s[kept])
            places = brought(api.get("/").text)["/api/v1/transducers"]["items"]
            return places[0]["last_set"]["set_index"]

        assert last_set("moment") == 0
        filled.add_set(1, stored=False)
        assert last_set("hour") == 0
        assert last_set("moment") == 1
