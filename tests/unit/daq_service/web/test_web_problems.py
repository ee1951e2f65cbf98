"""Requests that the service rejects, their problem details, and its commands."""

import orjson
import pytest
from support.filled_folder import FilledFolder, filled_folder
from support.served_web import served, served_app

from daq_service.catalogue.connection import FILE_NAME as CATALOGUE_FILE
from daq_service.processes.data_folder import hold_recorder_lock
from daq_service.processes.heartbeat import Heartbeat
from daq_service.settings.tree import Settings
from daq_service.web.answers import cursors
from daq_service.web.answers.models import CommandRow
from daq_service.web.answers.problem import TYPE_PREFIX, ProblemDetails, to_pointer
from daq_service.web.app import create_app
from daq_service.web.guards import LARGEST_BODY_BYTES


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(
        tmp_path_factory.mktemp("data"), Settings(clock={"pace_h_per_s": 5.0}), sets=4
    ) as folder:
        folder.add_alarm("B", 2)
        folder.add_alarm("C", 2, state="acknowledged")
        yield folder


def problem(answer, status, name):
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = ProblemDetails.model_validate_json(answer.content)
    assert body.status == status
    assert body.type == TYPE_PREFIX + name
    assert body.hint
    assert body.detail
    assert body.request_id == answer.headers["x-request-id"] != ""
    return answer.json()


def n_commands(filled):
    return len(filled.catalogue.list_open_commands())


# Reading


@pytest.mark.parametrize(
    ("query", "pointer"),
    [
        ("sets?limit=0", "/limit"),
        ("sets?limit=1001", "/limit"),
        ("sets?limit=many", "/limit"),
        ("sets?state=lost", "/state"),
        ("features?from_h=nan", "/from_h"),
        ("features?to_h=1e9", "/to_h"),
        ("features?scope=all", "/scope"),
        ("fits/B", "/field"),
        ("info?verbose=1", "/verbose"),
        ("alarms/1?actve=true", "/actve"),
        ("environment/latest?limit=1", "/limit"),
    ],
)
def test_invalid_query_points_at_the_parameter(api, query, pointer):
    body = problem(api.get(f"/api/v1/{query}"), 422, "invalid-request")
    assert [(part["in"], part["pointer"]) for part in body["errors"]] == [("query", pointer)]


@pytest.mark.parametrize(
    ("query", "remedy"),
    [
        ("sets?limits=5", "did you mean limit?"),
        ("environment?position=B", "there are cursor, from_h, limit, to_h"),
        ("health?deep=1", "this resource has no parameters"),
    ],
)
def test_unknown_parameter_is_refused_with_the_remedy(api, query, remedy):
    (part,) = problem(api.get(f"/api/v1/{query}"), 422, "invalid-request")["errors"]
    assert remedy in part["detail"]


def test_order_with_an_unknown_parameter_is_not_written(api, filled):
    before = n_commands(filled)
    problem(api.post("/api/v1/commands?force=1", json={"kind": "stop"}), 422, "invalid-request")
    assert n_commands(filled) == before


@pytest.mark.parametrize(
    "query",
    [
        "trends/B?fields=travel_time_s",
        "trends/A?fields=tof_pp_s",
        "trends/B?fields=,",
        "fits/B?field=tof_pp_s,tof_mf_s",
        "fits/B?field=set_index",
        "sets?from_h=5&to_h=4",
        "environment?from_h=5&to_h=4",
        "stream?topics=sets,gossip",
        "stream?topics=",
    ],
)
def test_request_that_contradicts_itself_is_422(api, query):
    problem(api.get(f"/api/v1/{query}"), 422, "invalid-request")


@pytest.mark.parametrize(
    "path", ["/api/v1/alarms/0", "/api/v1/alarms/9999999999999999999999", "/api/v1/alarms/x"]
)
def test_invalid_path_points_at_the_part(api, path):
    body = problem(api.get(path), 422, "invalid-request")
    assert body["errors"][0]["in"] == "path"
    assert body["errors"][0]["pointer"] == "/alarm_id"


def test_cursor_belongs_to_its_listing_and_filters(api):
    cursor = api.get("/api/v1/sets?limit=1&position=B").json()["next_cursor"]
    assert api.get(f"/api/v1/sets?limit=1&position=B&cursor={cursor}").status_code == 200
    problem(api.get(f"/api/v1/sets?limit=1&position=C&cursor={cursor}"), 422, "invalid-cursor")
    problem(api.get(f"/api/v1/assessments?limit=1&position=B&cursor={cursor}"), 422, "invalid-cursor")


@pytest.mark.parametrize(
    "cursor", ["", "x", "%F0%9F", "OTk5OTk5OTk", "====", cursors.encode_cursor("sets", 5)[:-1], "AA" * 90]
)
def test_invented_cursor_is_refused(api, cursor):
    problem(api.get(f"/api/v1/sets?cursor={cursor}"), 422, "invalid-cursor")


def test_pointer_escapes():
    assert to_pointer(["a/b", "c~d", 0]) == "/a~1b/c~0d/0"


def test_unknown_method_is_405(api):
    answer = api.delete("/api/v1/sets")
    problem(answer, 405, "method-not-allowed")
    assert answer.headers["allow"] == "GET"
    assert api.put("/api/v1/session").headers["allow"] == "DELETE, GET, POST"


def test_before_the_first_record_there_is_no_data(tmp_path):
    with served(Settings(), tmp_path) as service, service.client() as api:
        for path in ("/readyz", "/api/v1/info", "/api/v1/transducers", "/api/v1/trends/B", "/api/v1/alarms"):
            answer = api.get(path)
            problem(answer, 503, "no-data-yet")
            assert answer.headers["retry-after"] == "1"
        live = {"status": "ok", "data": False, "recorder": "not_started", "doing": None}
        assert api.get("/healthz").json() == live
        with hold_recorder_lock(tmp_path):
            Heartbeat(tmp_path, deadline_s=60.0).beat("compiling: part 1 of 3")
            working = {"recorder": "running", "doing": "compiling: part 1 of 3"}
            assert api.get("/healthz").json() == live | working
        # An experiment without a set is still no data; the same process sees the first set.
        filled = FilledFolder(tmp_path, Settings())
        problem(api.get("/api/v1/info"), 503, "no-data-yet")
        filled.add_set(0, stored=False)
        filled.close()
        assert api.get("/readyz").status_code == 200
        assert api.get("/api/v1/info").status_code == 200


def test_a_corrupt_catalogue_is_reported_and_not_shown(tmp_path):
    (tmp_path / CATALOGUE_FILE).write_bytes(b"no database at all" * 100)
    with served(Settings(), tmp_path) as service, service.client() as api:
        body = problem(api.get("/api/v1/info"), 503, "storage-unavailable")
        assert CATALOGUE_FILE in body["detail"]
        assert api.get("/healthz").json()["data"] is False


def test_an_internal_error_hides_its_details(tmp_path, caplog):
    app = create_app(Settings(), tmp_path)

    async def broken():
        raise RuntimeError("secret detail")

    app.add_api_route("/broken", broken)
    with served_app(app) as service, service.client() as api:
        body = problem(api.get("/broken"), 500, "internal-error")
    assert "secret" not in body["detail"]
    assert body["request_id"] in caplog.text
    assert "secret detail" in caplog.text


# Guards


def refused_stream(api, headers, status, kind):
    with api.stream("GET", "/api/v1/stream", headers=headers) as answer:
        assert answer.status_code == status, "before it is read: a stream that is served never ends"
        answer.read()
        problem(answer, status, kind)


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "evil.example:80", "[::2]", ""])
def test_foreign_host_is_refused(api, host):
    problem(api.get("/api/v1/info", headers={"Host": host}), 400, "foreign-host")
    refused_stream(api, {"Host": host}, 400, "foreign-host")


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]", "localhost:8750"])
def test_own_names_are_served(api, host):
    assert api.get("/healthz", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_orders_and_streams_of_other_origins_are_refused_and_nothing_is_written(api, filled, headers):
    before = n_commands(filled)
    for path, body in (("commands", {"kind": "stop"}), ("alarms/1/acknowledge", {})):
        problem(api.post(f"/api/v1/{path}", json=body, headers=headers), 403, "foreign-origin")
    refused_stream(api, headers, 403, "foreign-origin")
    assert n_commands(filled) == before


def test_a_body_above_the_limit_is_rejected(api):
    big = orjson.dumps({"kind": "stop", "author": "x" * LARGEST_BODY_BYTES})
    headers = {"Content-Type": "application/json"}
    problem(api.post("/api/v1/commands", content=big, headers=headers), 413, "body-too-large")

    def in_pieces():
        for start in range(0, len(big), 8192):
            yield big[start : start + 8192]

    # Without Content-Length.
    problem(api.post("/api/v1/commands", content=in_pieces(), headers=headers), 413, "body-too-large")


def test_every_answer_has_its_headers(api):
    for path in ("/", "/api/v1/info", "/api/v1/nothing", "/healthz", "/static/main.js"):
        headers = api.get(path).headers
        assert "script-src 'self'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert len(headers["x-request-id"]) == 32
    assert api.get("/api/v1/info").headers["cache-control"] == "no-store"


# Commands


def test_a_command_becomes_a_row_and_can_be_followed(api, filled):
    answer = api.post("/api/v1/commands", json={"kind": "finish_now", "author": "Ada"})
    assert answer.status_code == 202
    row = CommandRow.model_validate_json(answer.content, strict=True)
    assert (row.kind, row.author, row.state, row.arguments) == ("finish_now", "Ada", "pending", {})
    assert filled.catalogue.command(row.id).kind == "finish_now"
    filled.catalogue.finish_command(row.id, "done", "no pacing from here on")
    followed = api.get(answer.headers["location"]).json()
    assert (followed["state"], followed["result"]) == ("done", "no pacing from here on")


def test_the_own_origin_may_send_commands(api, service):
    headers = {"Origin": f"http://{service.netloc}", "Sec-Fetch-Site": "same-origin"}
    assert api.post("/api/v1/commands", json={"kind": "stop"}, headers=headers).status_code == 202


def test_acknowledgement_becomes_a_row(api, filled):
    answer = api.post("/api/v1/alarms/1/acknowledge", json={"author": "Ada", "note": "seen"})
    assert answer.status_code == 202, answer.text
    row = filled.catalogue.command(answer.json()["id"])
    assert row.kind == "acknowledge_alarm"
    assert row.arguments == {"alarm_id": 1, "note": "seen"}
    # The service only stores the command: the recorder changes the alarm.
    assert filled.catalogue.alarm(1).state == "unacknowledged"


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({"kind": "explode"}, ""),
        ({"kind": "stop", "arguments": {"now": True}}, "/stop/arguments/now"),
        ({"kind": "stop", "author": ""}, "/stop/author"),
        ({"kind": "acknowledge_alarm"}, "/acknowledge_alarm/arguments"),
        ({"kind": "resume", "arguments": {"note": "x" * 2001}}, "/resume/arguments/note"),
        ({"kind": "supply_on"}, "/supply_on/author"),
    ],
)
def test_an_invalid_command_is_rejected_with_a_pointer(api, filled, body, pointer):
    before = n_commands(filled)
    errors = problem(api.post("/api/v1/commands", json=body), 422, "invalid-request")["errors"]
    assert errors[0]["in"] == "body"
    assert errors[0]["pointer"] == pointer
    assert n_commands(filled) == before
