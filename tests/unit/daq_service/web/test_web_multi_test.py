"""Several tests in one service: names, errors in the list, opening on request, one login."""

import asyncio
import shutil
from contextlib import ExitStack
from dataclasses import dataclass

import httpx2
import pytest
from support.filled_folder import FilledFolder, filled_folder
from support.reported_alarms import notifying
from support.served_web import Served, brought, served, served_app, stream_events, take
from support.table_rows import execute
from support.waiting import until

from daq_service import client as solimon_client
from daq_service.commands.audit import read_audit_log
from daq_service.errors import UsageError
from daq_service.settings.tree import Settings
from daq_service.settings.web import WebSettings
from daq_service.web.auth.middleware import AccessPolicy
from daq_service.web.auth.tokens import create_token
from daq_service.web.multi_test.app import create_multi_test_app
from daq_service.web.multi_test.listing import Listing
from daq_service.web.multi_test.location import REMEDIES
from daq_service.web.multi_test.names import build_slug, build_unique_slugs
from daq_service.web.multi_test.open_tests import ServedTests

HOLE, TWIN = Settings(name="Hole Nr. 2"), Settings(name="Hole: its twin", clock={"pace_h_per_s": 5.0})


@dataclass(frozen=True, slots=True)
class Several:
    service: Served
    client: httpx2.Client
    hole: FilledFolder
    twin: FilledFolder

    def listed(self):
        return {row["test"]: row for row in self.client.get("/api/v1/tests").json()["items"]}


def app_of(*folders, own, settings=None):
    return create_multi_test_app(folders, settings or Settings(), own)


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    with ExitStack() as left:
        folders = []
        for settings, sets in ((HOLE, 3), (TWIN, 5)):
            filled = FilledFolder(tmp_path_factory.mktemp("test"), settings)
            left.callback(filled.close)
            for index in range(sets):
                filled.add_set(index, stored=index == 0)
            folders.append(filled)
        hole, twin = folders
        hole.add_alarm("B", 2)
        app = app_of(hole.folder, twin.folder, own=tmp_path_factory.mktemp("own"))
        service = left.enter_context(served_app(app))
        yield Several(service, left.enter_context(service.client()), hole, twin)


@pytest.mark.parametrize(
    ("text", "name"),
    [("Hole Nr. 2", "hole-nr-2"), ("Größe/../Öl", "grosse-ol"), ("  ?#%  ", "test"), ("a" * 300, "a" * 60)],
)
def test_a_name_in_addresses_is_of_small_letters_digits_and_hyphens(text, name):
    assert build_slug(text) == name


def test_names_that_are_taken_are_numbered():
    assert build_unique_slugs(["Hole", "hole", "Hole 2", "HOLE!"]) == [
        "hole",
        "hole-2",
        "hole-2-2",
        "hole-3",
    ]


def test_the_list_has_the_status_of_each_test(several):
    listed = several.listed()
    assert list(listed) == ["hole-nr-2", "hole-its-twin"]
    hole, twin = listed.values()
    assert (hole["name"], hole["page"], hole["state"]) == ("Hole Nr. 2", "/tests/hole-nr-2/", "shown")
    standing = hole["standing"]
    assert (standing["recorder"], standing["state"]) == ("running", "alarm")
    assert (standing["active_alarms"], standing["highest_priority"]) == (1, "high")
    assert standing["last_set_index"] == 2
    assert standing["last_set_h"] == several.hole.due[2].due_h
    assert [place["position"] for place in standing["positions"]] == list(HOLE.positions)
    assert (twin["standing"]["last_set_index"], twin["standing"]["highest_priority"]) == (4, None)


def test_each_test_has_the_whole_interface_below_its_name(several):
    for row, filled in zip(several.listed().values(), (several.hole, several.twin), strict=True):
        with (
            served(filled.settings, filled.folder) as alone,
            alone.client() as of_one,
            several.service.client() as of_many,
        ):
            pages = (of_one.get("/"), several.client.get(row["page"]))
            infos = [brought(page.text)["/api/v1/info"] for page in pages]
            assert infos[0]["name"] == infos[1]["name"] == row["name"]
            for path in ("sets", "features?position=B", "trends/B", "alarms", "waveforms/B/0/0?format=npy"):
                one, many = of_one.get(f"/api/v1/{path}"), of_many.get(f"{row['api']}/{path}")
                assert one.status_code == many.status_code == 200
                if path.endswith("npy"):
                    assert many.content == one.content
                elif "items" in one.json():
                    strip = [{**item, "age_h": None} for item in many.json()["items"]]
                    assert strip == [{**item, "age_h": None} for item in one.json()["items"]]
                else:
                    assert many.json()["columns"] == one.json()["columns"]


def test_each_test_describes_itself_at_its_prefix(several):
    description = several.client.get("/tests/hole-nr-2/api/v1/openapi.json").json()
    assert [server["url"] for server in description["servers"]] == ["/tests/hole-nr-2"]
    assert "/api/v1/trends/{position}" in description["paths"]
    again = several.client.get("/tests/hole-its-twin/api/v1/openapi.json").json()
    assert [server["url"] for server in again["servers"]] == ["/tests/hole-its-twin"]
    own = several.client.get("/api/v1/openapi.json").json()
    assert {"/api/v1/tests", "/api/v1/session", "/healthz", "/readyz", "/metrics"} <= own["paths"].keys()
    assert "servers" not in own


def test_a_problem_names_the_whole_path_and_an_unknown_test_the_list(several):
    problem = several.client.get("/tests/hole-nr-2/api/v1/trends/Q").json()
    assert (problem["status"], problem["instance"]) == (404, "/tests/hole-nr-2/api/v1/trends/Q")
    assert "positions are A, B, C, D" in problem["hint"]
    for path in ("/tests/hole/api/v1/info", "/tests/hole/"):
        problem = several.client.get(path).json()
        assert (problem["status"], problem["hint"]) == (404, "/api/v1/tests lists them.")
    problem = several.client.get("/api/v1/info").json()
    assert problem["status"] == 404
    assert "/tests/NAME/api/v1" in problem["hint"]


def test_the_stream_of_a_test_has_only_its_own_events(several):
    with (
        several.service.client() as reader,
        reader.stream("GET", "/tests/hole-its-twin/api/v1/stream?topics=service") as stream,
    ):
        events = stream_events(stream)
        several.hole.say("note_of_the_hole")
        several.twin.say("note_of_the_twin")
        (event,) = take(events, 1)
    assert event.data["kind"] == "note_of_the_twin"


def test_streams_of_all_tests_share_one_budget(several, monkeypatch):
    monkeypatch.setattr("daq_service.web.routes.stream.MOST_CLIENTS", 1)
    with (
        several.service.client() as reader,
        reader.stream("GET", "/tests/hole-its-twin/api/v1/stream") as stream,
    ):
        lines = stream.iter_lines()
        next(lines)
        refused = several.client.get("/tests/hole-nr-2/api/v1/stream")
    assert (refused.status_code, refused.json()["type"]) == (503, "urn:solimon:problem:too-many-streams")
    assert refused.headers["retry-after"] == "1"


def test_a_command_is_audited_in_the_folder_of_its_test(several):
    order = {"kind": "pause", "author": "ann", "arguments": {"note": "hands in the rig"}}
    assert several.client.post("/tests/hole-nr-2/api/v1/commands", json=order).status_code == 202
    (entry, *_) = several.client.get("/tests/hole-nr-2/api/v1/audit").json()["items"]
    assert (entry["what"], entry["author"]) == ("pause", "ann")
    assert several.client.get("/tests/hole-its-twin/api/v1/audit").json()["items"] == []
    assert several.client.get("/api/v1/audit").json()["items"] == []


def test_the_client_reads_a_test_by_its_address(several):
    with solimon_client.open(f"{several.service.url}tests/hole-its-twin") as test:
        assert test.info()["name"] == TWIN.name
        assert test.features("B")["set_index"].tolist() == list(range(5))


def test_a_socket_of_a_test_that_is_not_there_is_refused(several):
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    with (
        pytest.raises(InvalidStatus) as refused,
        connect(f"ws://{several.service.netloc}/tests/none/api/v1/waveforms/live"),
    ):
        pass
    assert refused.value.response.status_code == 404
    with connect(f"ws://{several.service.netloc}/tests/hole-nr-2/api/v1/waveforms/live?positions=B"):
        pass


def test_an_unreadable_folder_is_listed_with_its_remedy_and_disturbs_no_other(tmp_path, several):
    missing, empty, foreign = tmp_path / "missing", tmp_path / "empty", tmp_path / "foreign"
    damaged, other, refused = tmp_path / "damaged", tmp_path / "other", tmp_path / "refused.toml"
    empty.mkdir()
    foreign.mkdir()
    (foreign / "thesis.docx").write_text("precious")
    for folder in (damaged, other):
        shutil.copytree(several.twin.folder, folder)
        (folder / "experiment.json").unlink(missing_ok=True)
    (damaged / "catalogue.sqlite").write_bytes(b"no database at all" * 1000)
    for suffix in ("-wal", "-shm"):
        (damaged / f"catalogue.sqlite{suffix}").unlink(missing_ok=True)
    execute(other, "UPDATE alembic_version SET version_num = '9999'")
    refused.write_text("[chain]\nmass_kg = -1.0")
    before = sorted(path for path in tmp_path.rglob("*") if not path.name.startswith("catalogue.sqlite-"))
    paths = [missing, empty, foreign, damaged, other, refused, several.twin.folder]
    with served_app(app_of(*paths, own=tmp_path / "own")) as service, service.client() as client:
        rows = client.get("/api/v1/tests").json()["items"]
        states = [row["state"] for row in rows]
        assert states == [
            *("missing", "no_data", "foreign", "damaged", "other_version", "misconfigured", "shown")
        ]
        for row in rows[:-1]:
            assert row["remedy"] == REMEDIES[row["state"]]
            assert row["detail"]
            answer = client.get(f"{row['api']}/info")
            assert answer.status_code == 503
            assert brought(client.get(row["page"]).text).keys() == {"/api/v1/session"}
            assert (answer.json()["detail"], answer.json()["hint"]) == (row["detail"], row["remedy"])
        assert client.get(f"{rows[-1]['api']}/info").json()["name"] == TWIN.name
        assert client.get("/readyz").json() == {"status": "ok", "data": True, "tests": 7, "shown": 1}
    after = sorted(path for path in tmp_path.rglob("*") if not path.name.startswith("catalogue.sqlite-"))
    assert after == before, "nothing is made by looking"


def test_a_test_that_starts_later_appears_under_its_configured_name(tmp_path, monkeypatch):
    monkeypatch.setattr("daq_service.web.multi_test.listing.CHANGING_S", 0.0)
    folder = tmp_path / "Plate 7"
    folder.mkdir()
    with (
        served_app(app_of(folder, tmp_path / "none", own=tmp_path / "own")) as service,
        service.client() as client,
    ):
        assert client.get("/readyz").status_code == 503
        assert client.get("/healthz").json() == {"status": "ok", "data": False, "tests": 2, "shown": 0}
        (row, _) = client.get("/api/v1/tests").json()["items"]
        assert (row["test"], row["name"], row["state"]) == ("plate-7", "Plate 7", "no_data")
        filled = FilledFolder(folder, HOLE)
        filled.add_set(0, stored=False)
        (row, _) = client.get("/api/v1/tests").json()["items"]
        assert (row["test"], row["name"], row["state"]) == ("plate-7", HOLE.name, "shown")
        assert client.get("/tests/plate-7/api/v1/info").json()["name"] == HOLE.name
        assert client.get("/readyz").status_code == 200
        filled.close()


def test_an_ended_test_is_read_again_only_when_its_files_change(tmp_path, several, monkeypatch):
    monkeypatch.setattr("daq_service.web.multi_test.listing.CHANGING_S", 0.0)
    with filled_folder(tmp_path, HOLE, sets=1) as filled:
        filled.say("schedule_done")
        filled.recorder_ends()
        listing = Listing(ServedTests([tmp_path, several.hole.folder], AccessPolicy(WebSettings(), tmp_path)))
        read = []
        look_at = Listing._read_entry
        monkeypatch.setattr(
            Listing, "_read_entry", lambda self, test: read.append(test.title) or look_at(self, test)
        )
        first = listing.read_entries()
        assert [row["standing"]["recorder"] for row in first] == ["finished", "running"]
        listing.read_entries()
        assert len(read) == 3, "the running one again, the ended one not"
        filled.add_set(1, stored=False)
        (row, _) = listing.read_entries()
        assert row["standing"]["last_set_index"] == 1


def test_the_same_folder_twice_is_refused_with_both_paths(tmp_path):
    config = tmp_path / "test.toml"
    config.write_text('[storage]\nfolder = "data"')
    with pytest.raises(UsageError, match=r"test\.toml and .*data mean the same test"):
        app_of(config, tmp_path / "data", own=tmp_path)


def inside(service):
    return service.app.state.tests


def test_used_and_a_few_recent_tests_stay_open(several, tmp_path, monkeypatch):
    monkeypatch.setattr("daq_service.web.multi_test.open_tests.MOST_IDLE", 1)
    app = app_of(several.hole.folder, several.twin.folder, own=tmp_path)
    with served_app(app) as service, service.client() as client, service.client() as reader:

        def opened():
            return [test.name for test in inside(service).all.values() if test.context is not None]

        client.get("/api/v1/tests")
        client.get("/metrics")
        assert opened() == [], "neither the list nor the metrics keep a test open"
        client.get("/tests/hole-nr-2/static/main.js")
        assert opened() == [], "nor do the scripts of its page"
        client.get("/tests/hole-nr-2/")
        assert opened() == ["hole-nr-2"]
        client.get("/tests/hole-its-twin/api/v1/info")
        assert opened() == ["hole-its-twin"]
        with reader.stream("GET", "/tests/hole-its-twin/api/v1/stream") as stream:
            lines = stream.iter_lines()
            next(lines)
            client.get("/tests/hole-nr-2/api/v1/info")
            assert opened() == ["hole-nr-2", "hole-its-twin"], "who follows one keeps it open"
        assert client.get("/tests/hole-nr-2/api/v1/info").json()["name"] == HOLE.name


def test_a_test_with_receivers_is_open_from_the_start(several, tmp_path):
    (tmp_path / "watched").mkdir()
    with filled_folder(tmp_path / "watched", notifying(), sets=1) as watched:
        app = app_of(watched.folder, several.twin.folder, own=tmp_path / "own")
        with served_app(app) as service, service.client() as client:
            tests = list(inside(service).all.values())
            until(lambda: tests[0].context is not None, "it is open")
            assert client.get(f"/tests/{tests[0].name}/api/v1/notifications").json()["sending"] is True
            asyncio.run(inside(service).close_idle_tests(keep=0))
            assert tests[0].context is not None
            assert tests[1].context is None


def test_one_login_is_valid_for_all_tests_of_the_service_alone(several, tmp_path):
    _, viewer = create_token(tmp_path / "tokens.json", "vera", "viewer")
    _, admin = create_token(tmp_path / "tokens.json", "ada", "admin")
    app = app_of(several.hole.folder, several.twin.folder, own=tmp_path)
    with served_app(app) as service, service.client() as client:
        for path in ("/", "/static/main.js", "/tests/hole-nr-2/", "/tests/hole-nr-2/healthz", "/healthz"):
            assert client.get(path).status_code == 200, path
        inside = ("/api/v1/tests", "/metrics", "/tests/hole-nr-2/api/v1/info", "/tests/none/api/v1/info")
        for path in inside:
            assert client.get(path).status_code == 401, path
        assert client.post("/api/v1/session", json={"token": viewer}).json()["name"] == "vera"
        for path in (*inside[:3], "/tests/hole-its-twin/api/v1/info"):
            assert client.get(path).status_code == 200, path
        order = {"kind": "disable", "author": "x", "arguments": {"position": "B"}}
        assert client.post("/tests/hole-its-twin/api/v1/commands", json=order).status_code == 403
        deeds, _ = read_audit_log(tmp_path, limit=10)
        assert [(deed.what, deed.author) for _, deed in deeds] == [("log_in", "vera")]
        headers = {"Authorization": f"Bearer {admin}"}
        (refusal,) = client.get("/tests/hole-its-twin/api/v1/audit", headers=headers).json()["items"]
        assert (refusal["what"], refusal["author"], refusal["result"]) == (
            "create_command",
            "vera",
            "rejected",
        )


def test_a_test_whose_own_service_asks_for_tokens_is_not_shown_without_any(several, tmp_path):
    folder = tmp_path / "locked"
    shutil.copytree(several.hole.folder, folder)
    create_token(folder / "tokens.json", "ann", "admin")
    with served_app(app_of(folder, several.twin.folder, own=tmp_path)) as service, service.client() as client:
        (row, _) = client.get("/api/v1/tests").json()["items"]
        assert row["state"] == "locked"
        assert "web.tokens_file" in row["remedy"]
        assert client.get(f"{row['api']}/info").status_code == 503
        assert brought(client.get(row["page"]).text).keys() == {"/api/v1/session"}
        assert "locked" not in client.get("/metrics").text
    _, text = create_token(tmp_path / "tokens.json", "ada", "viewer")
    with (
        served_app(app_of(folder, several.twin.folder, own=tmp_path)) as service,
        service.client(Authorization=f"Bearer {text}") as client,
    ):
        assert client.get("/tests/hole-nr-2/api/v1/info").status_code == 200


def test_the_token_check_applies_to_every_test(several):
    for path in ("/api/v1/tests", "/tests/hole-nr-2/api/v1/info"):
        assert several.client.get(path, headers={"Host": "evil.example"}).status_code == 400
    order = {"kind": "pause", "arguments": {"note": "x"}}
    for test in ("hole-nr-2", "none"):
        path = f"/tests/{test}/api/v1/commands"
        answer = several.client.post(path, json=order, headers={"Origin": "http://evil.example"})
        assert answer.status_code == 403
    foreign = {"Sec-Fetch-Site": "cross-site"}
    assert several.client.get("/tests/hole-nr-2/api/v1/stream", headers=foreign).status_code == 403
    refused = several.client.put("/tests/hole-nr-2/api/v1/session")
    assert (refused.status_code, refused.headers["allow"]) == (405, "DELETE, GET, POST")
    for path in (
        "/tests/../etc/passwd",
        "/tests/%2e%2e/api/v1/info",
        "/tests/hole-nr-2/static/%2e%2e/app.py",
    ):
        assert several.client.get(path).status_code == 404
