"""Every query of the Grafana dashboard and of its page uses existing metrics and labels."""

import json
import re
import shutil
from pathlib import Path

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families
from support.filled_folder import filled_folder
from support.served_web import served, served_app

from daq_service.settings.tree import Settings
from daq_service.web.multi_test.app import create_multi_test_app

ROOT = Path(__file__).parents[4]
DASHBOARD = json.loads((ROOT / "examples/grafana/solimon.json").read_text(encoding="utf-8"))
TARGETS = [
    (panel["title"], target["expr"], target["legendFormat"])
    for panel in DASHBOARD["panels"]
    for target in panel["targets"]
]
RULES = re.findall(r"^- `(.+?)`:", (ROOT / "docs/how-to/grafana.md").read_text(encoding="utf-8"), re.M)
OF_PROMETHEUS = {"instance", "job"}
OF_SEVERAL = "test"
"""A label of each sample of a test where the service has several."""
OF_THE_SERVICE = "solimon_http_"
"""Metrics that are about no test."""
FUNCTIONS = {"absent", "histogram_quantile", "increase", "label_values", "rate", "sum"}
SELECTOR = re.compile(r"(?P<name>[A-Za-z_:][\w:]*)(?:\{(?P<labels>[^}]*)\})?(?P<range>\[\w+\])?")
GROUPING = re.compile(r"\bby \((?P<labels>[^)]*)\)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a test with all kinds of data."""
    with filled_folder(tmp_path_factory.mktemp("data")) as folder:
        for index in range(60):
            folder.add_set(index, stored=index == 0)
        folder.add_alarm("B", 55)
        folder.catalogue.add_command("ann", "pause", {"note": "hands"})
        yield folder


@pytest.fixture(scope="module", params=["one test", "several tests"])
def families(request, folder, tmp_path_factory):
    """Return the metric families of a service with one test and of one with the test and its copy."""
    below = [""]
    if request.param == "one test":
        service = served(folder.settings, folder.folder)
    else:
        copy = tmp_path_factory.mktemp("copy") / "data"
        shutil.copytree(folder.folder, copy)
        app = create_multi_test_app([folder.folder, copy], Settings(), tmp_path_factory.mktemp("own"))
        service, below = served_app(app), [f"/tests/{name}" for name in app.state.tests.all]
    with service as running, running.client() as api:
        for prefix in below:
            for path in ("tables/sets", "waveforms/B"):
                assert api.get(f"{prefix}/api/v1/{path}").status_code == 200
        return list(text_string_to_metric_families(api.get("/metrics").text))


@pytest.fixture(scope="module")
def label_sets(families):
    found = {}
    for family in families:
        for sample in family.samples:
            found.setdefault(sample.name, []).append(sample.labels)
    return found


def selectors(expression):
    """Return name, label matchers and range of each series of the query."""
    bare = GROUPING.sub("", expression)
    for match in SELECTOR.finditer(bare):
        labels = OF_PROMETHEUS | {OF_SEVERAL}
        if bare[match.end() :].lstrip().startswith("(") or match["name"] in labels:
            assert match["name"] in FUNCTIONS | labels, f"no function of PromQL: {match['name']}"
        elif not re.search(rf"[\d.]{re.escape(match['name'])}", bare):
            matchers = re.findall(r'(\w+)(=~|!~|!=|=)"([^"]*)"', match["labels"] or "")
            yield match["name"], matchers, match["range"]


def check(expression, label_sets):
    """Return the possible labels of the result."""
    queried = list(selectors(expression))
    assert queried, expression
    for name, matchers, _ in queried:
        assert name in label_sets, f"{name} is not told"
        for label, sign, value in matchers:
            if label in OF_PROMETHEUS or (label, value) == (OF_SEVERAL, "$test"):
                continue
            values = {labels.get(label) for labels in label_sets[name]}
            assert None not in values, f"{name} has no label {label}"
            assert sign in ("=", "=~"), "what is left out is not looked for here"
            pattern = value if sign == "=~" else re.escape(value)
            assert any(re.fullmatch(pattern, item) for item in values), f"no {label} of {name} is {value}"
    groups = {
        label.strip() for found in GROUPING.finditer(expression) for label in found["labels"].split(",")
    }
    common = set.intersection(*({*labels} for name, _, _ in queried for labels in label_sets[name]))
    assert groups - {OF_SEVERAL} <= common, f"{groups - common} is no label there"
    is_summed = re.search(r"\bsum\b", expression)
    return (groups if is_summed else common | OF_PROMETHEUS), queried


@pytest.mark.parametrize(("title", "expression", "legend"), TARGETS)
def test_every_query_of_the_dashboard_finds_its_metrics_and_labels(title, expression, legend, label_sets):
    labels, queried = check(expression, label_sets)
    assert set(re.findall(r"\{\{(\w+)\}\}", legend)) <= labels | {OF_SEVERAL}, f"the legend of {title!r}"
    tests = {labels[OF_SEVERAL] for labels in label_sets["solimon_has_data"] if OF_SEVERAL in labels}
    for name, matchers, _ in queried:
        chosen = (OF_SEVERAL, "=~", "$test") in matchers
        assert chosen is not name.startswith(OF_THE_SERVICE), f"{title!r} shows the tests that are chosen"
        if chosen:  # "All" is ".*", which in Prometheus also finds what has no such label
            assert {labels.get(OF_SEVERAL) for labels in label_sets[name]} == (tests or {None})


@pytest.mark.parametrize(
    "expression", [*RULES, *(variable["query"] for variable in DASHBOARD["templating"]["list"][1:])]
)
def test_every_rule_and_the_variables_find_theirs_too(expression, label_sets):
    check(expression, label_sets)


@pytest.mark.parametrize("expression", [*(expression for _, expression, _ in TARGETS), *RULES])
def test_only_counters_are_queried_as_a_rate(expression, families):
    growing = {
        sample.name
        for family in families
        if family.type in ("counter", "histogram")
        for sample in family.samples
    }
    for name, _, over in selectors(expression):
        assert (name in growing) is (over is not None), name


def test_every_metric_of_ours_has_its_type_and_its_unit_in_its_name(families):
    """The parser rejects what OpenMetrics forbids; this checks the rest."""
    assert {family.type for family in families} <= {"gauge", "counter", "info", "histogram"}
    for family in families:
        assert family.name == "solimon" or family.name.startswith("solimon_")
        assert family.documentation
        # Prometheus wants base units, as whole words.
        assert not re.search(r"_(s|ms|us|mm|m|h|b|kb|percent)$", family.name), family.name
        for sample in family.samples:
            if family.type == "counter":
                assert sample.name == f"{family.name}_total"
                assert sample.value == int(sample.value) >= 0
            if "state" in sample.labels and family.name != "solimon_alarms_active":
                assert sample.value in (0.0, 1.0), "one series a state"


def test_the_dashboard_can_be_imported():
    """Ids are unique, panels do not overlap, and the data source is a variable."""
    panels = DASHBOARD["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    taken = set()
    for panel in panels:
        assert panel["datasource"]["uid"] == "$datasource"
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert not cells & taken, panel["title"]
        assert max(x for x, _ in cells) < 24
        taken |= cells
    assert len(RULES) == 6
    assert [variable["allValue"] for variable in DASHBOARD["templating"]["list"][1:]] == [".*", ".*"]
