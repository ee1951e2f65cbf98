"""Notes on hours of the test: created by commands, listed by range, withdrawn but never erased."""

import pytest
from support.filled_folder import filled_folder
from support.served_web import served


@pytest.fixture(scope="module")
def api(tmp_path_factory):
    """Return the client of an ended test, where each command is executed within its request."""
    with filled_folder(tmp_path_factory.mktemp("ended"), sets=2) as filled:
        filled.say("schedule_done", filled.due[1].due_utc_ns)
    with served(filled.settings, filled.folder) as service, service.client() as client:
        yield client


def ordered(api, kind, author, **arguments):
    return api.post("/api/v1/commands", json={"kind": kind, "author": author, "arguments": arguments})


def note(api, **body):
    return ordered(api, "annotate", "Ada", **body)


def listed(api, query=""):
    return api.get(f"/api/v1/annotations?{query}").json()["items"]


def test_a_note_is_listed_sent_on_the_stream_and_withdrawn_without_being_erased(api):
    answer = note(api, from_h=1.0, to_h=2.5, position="B", text=" couplant renewed ")
    assert (answer.status_code, answer.json()["kind"], answer.json()["state"]) == (202, "annotate", "done")
    (row,) = listed(api)
    assert (row["from_h"], row["to_h"], row["position"], row["text"], row["author"]) == (
        *(1.0, 2.5, "B"),
        "couplant renewed",
        "Ada",
    )
    assert (row["from_utc"], row["to_utc"]) == ("2024-01-01T01:00:00Z", "2024-01-01T02:30:00Z")
    withdrawn = ordered(api, "withdraw_annotation", "ben", annotation_id=row["id"])
    assert withdrawn.json()["result"] == "withdrawn"
    assert listed(api, "withdrawn=false") == []
    (kept,) = listed(api, "withdrawn=true")
    assert (kept["text"], kept["author"], kept["withdrawn_by"]) == ("couplant renewed", "Ada", "ben")
    again = ordered(api, "withdraw_annotation", "operator", annotation_id=row["id"])
    assert (again.status_code, again.json()["detail"]) == (
        409,
        f"Annotation {row['id']} was withdrawn by ben already.",
    )
    assert ordered(api, "withdraw_annotation", "ben", annotation_id=99).status_code == 404


def test_a_range_of_hours_is_half_open_and_finds_what_reaches_into_it(api):
    for from_h, to_h, text in [(10.0, None, "instant"), (11.0, 14.0, "range"), (20.0, 21.0, "later")]:
        assert note(api, from_h=from_h, to_h=to_h, text=text).status_code == 202
    found = {
        (low, high): [row["text"] for row in listed(api, f"from_h={low}&to_h={high}")]
        for low, high in [(10, 11), (9, 10), (12, 13), (14, 20), (21, 30), (9, 30)]
    }
    assert found == {
        (10, 11): ["instant"],
        (9, 10): [],
        (12, 13): ["range"],
        (14, 20): ["range"],
        (21, 30): ["later"],
        (9, 30): ["instant", "range", "later"],
    }
