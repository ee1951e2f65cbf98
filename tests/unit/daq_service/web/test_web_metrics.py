"""`/metrics` is OpenMetrics, agrees with the page, and reads no history."""

from prometheus_client.openmetrics.parser import text_string_to_metric_families
from support.filled_folder import LIMIT_F, served_folder


def samples(api):
    answer = api.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("application/openmetrics-text")
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def value(found, name, **labels):
    return found[(f"solimon_{name}", frozenset(labels.items()))]


def test_metrics_agree_with_the_page(tmp_path):
    with served_folder(tmp_path, shots_per_set=2) as (folder, api):
        empty = samples(api)
        assert value(empty, "has_data") == 0
        for index in range(60):
            folder.add_set(index, stored=False)
        folder.add_alarm("B", 55)
        found = samples(api)
        places = {item["position"]: item for item in api.get("/api/v1/transducers").json()["items"]}
    at_b = places["B"]
    assert value(found, "time_of_flight_seconds", position="B") == at_b["last_feature"]["tof_pp_s"]
    assert value(found, "distance_squared", position="B") == at_b["last_assessment"]["distance_squared"]
    assert value(found, "distance_squared_limit", position="B") == LIMIT_F
    assert value(found, "thickness_meters", position="A") == places["A"]["last_thickness"]["thickness_m"]
    assert value(found, "data_age_seconds", position="B") == 3600.0 * at_b["age_h"]
    assert value(found, "position_state", position="B", state="alarm") == 1
    assert value(found, "position_state", position="C", state="alarm") == 0
    assert value(found, "quality", position="B", state="good") == 1
    labels = {"kind": "wall_change", "priority": "high", "state": "unacknowledged", "position": "B"}
    labels["suppressed"] = ""
    assert value(found, "alarms_active", **labels) == 1
    assert value(found, "shots_total") == 60 * 3 * 2
    assert value(found, "missed_sets_total") == 0
    assert value(found, "recorder_state", state="running") == 1
    assert value(found, "http_answer_seconds_count", route="/metrics") == 1, "the first of the two"
    assert not [name for name, labels in found if dict(labels).get("position") == "A" and "distance" in name]
