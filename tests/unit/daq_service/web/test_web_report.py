"""A report agrees with the client, is self-contained, and is made by command and service."""

import json
import re
from contextlib import nullcontext
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner
from support.filled_folder import LIMIT_CHART, filled_folder, frozen_baseline
from support.invented_rows import set_row
from support.missing_modules import environment_without
from support.served_web import served
from support.small_experiment import AtOnce

from daq_service import client
from daq_service.alarms.states import describe_alarm, format_number
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, FeatureRow, SetRow, ThicknessRow
from daq_service.cli.main import cli
from daq_service.errors import UsageError
from daq_service.settings.tree import Settings
from daq_service.web.auth.tokens import create_token
from daq_service.web.report import contents
from daq_service.web.report.contents import read_report_contents
from daq_service.web.report.figures import GREEN, draw_position_figure
from daq_service.web.routes import report as route
from daq_service.web.templates import (
    _create_environment,
    format_quantity,
)

N_SETS = 56
HEADINGS = ("h2", "h3", "h4")
NOTE = "seen <b>&amp;"
FORECAST = {"forecast_low_m": 5.2e-3, "forecast_m": 5.6e-3, "forecast_high_m": 6.1e-3}
OF_SERIES = {
    "Time of flight": ("features", "tof_pp_s", 1e6, 1, "µs"),
    "Amplitude ratio": ("features", "amplitude_ratio", 1.0, 3, ""),
    "Squared distance": ("assessments", "distance_squared", 1.0, 1, ""),
    "Wall thickness": ("thickness", "thickness_m", 1e3, 2, "mm"),
}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data")) as folder:
        without = folder.wall
        folder.wall = lambda position, hour: (
            without(position, hour) | ({"forecast_h": 1.25 * hour, **FORECAST} if position == "B" else {})
        )
        for index in range(N_SETS):
            folder.add_set(index, stored=index in (0, N_SETS - 1))
        alarm = folder.add_alarm("B", 52)
        order = {"alarm_id": alarm, "note": NOTE}
        command_id = folder.catalogue.add_command("ann", "acknowledge_alarm", order)
        folder.acknowledge(alarm, folder.catalogue.command(command_id))
        folder.shelve(folder.add_alarm("C", 10), "a new coil comes", for_h=1.0)
        folder.annotate(3.0, "couplant <renewed>", to_h=5.5, position="B")
        folder.annotate(20.0, "door open")
        quality = {"n": 48, "false_alarms_per_sensor_year": 0.2, "rate_verified": False}
        unverified = frozen_baseline(
            "B", baseline_quality={**quality, "rate_not_verified_reason": "few sets"}
        )
        verified = frozen_baseline("C", baseline_quality={**quality, "rate_verified": True}, approval="ann")
        folder.catalogue.commit_set(SetCommit(baselines=[unverified, verified]))
        (newest,) = folder.catalogue.rows(AssessmentRow, position="B", set_index=N_SETS - 1)
        details = {"probabilities": {"ok": 0.004, "sensor": 0.0199, "wall": 0.9761}}
        folder.catalogue.restore_rows([replace(newest, diagnosis_details=details)])
        for index in (N_SETS, N_SETS + 1, N_SETS + 3):
            folder.catalogue.commit_set(SetCommit(sets=[missed(folder, index)]))
        yield folder


def missed(folder, index):
    due = {"due_utc_ns": folder.due[index].due_utc_ns, "due_h": folder.due[index].due_h}
    return set_row(index, "D", **due, state="missed", reason="held", n_planned=1)


def as_shown(text):
    """Return a text with the spaces that a browser shows."""
    return " ".join(text.split())


class Page(HTMLParser):
    """Table rows below each heading, all words, and the resources that the page would load."""

    def __init__(self, content):
        super().__init__()
        self.tables, self.words, self.loaded, self.ids = {}, [], [], []
        self._heading, self._row, self._tag = "", None, ""
        self.feed(content.decode())

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self._tag = tag
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.loaded += [value for name, value in attrs if name in ("src", "data", "srcset")]
        href = attributes.get("href") or attributes.get("xlink:href") or "#"
        self.loaded += [] if href.startswith("#") else [href]
        if tag in ("script", "link", "iframe"):
            self.loaded.append(tag)
        if tag in HEADINGS:
            self._heading = ""
        if tag == "tr":
            self._row = []
        if tag in ("td", "th") and self._row is not None:
            self._row.append("")

    def handle_endtag(self, tag):
        if tag == "tr":
            self.tables.setdefault(self._heading, []).append([as_shown(cell) for cell in self._row])
            self._row = None

    def handle_data(self, data):
        self.words.append(as_shown(data))
        if self._row:
            self._row[-1] += data
        elif self._tag in HEADINGS and data.strip():
            self._heading = data


def find_alarm(page, alarm_id):
    return next(rows for heading, rows in page.tables.items() if heading.startswith(f"Alarm {alarm_id}: "))


def make_report(folder, *arguments):
    done = CliRunner().invoke(cli, ["report", str(folder), *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done


@pytest.fixture(scope="module")
def page(filled, tmp_path_factory):
    target = tmp_path_factory.mktemp("out") / "report.html"
    make_report(filled.folder, "--out", target)
    return Page(target.read_bytes())


def test_the_tables_have_the_numbers_of_the_client(filled, page):
    with client.open(filled.folder) as test:
        for position, names in {"A": ["Wall thickness"], **dict.fromkeys("BCD", list(OF_SERIES)[:3])}.items():
            rows = {row[0]: row[1:] for row in page.tables[f"Position {position}"]}
            for name in names:
                table, column, *shown = OF_SERIES[name]
                values = getattr(test, table)(position)[column].dropna()
                expected = (values.iloc[0], values.iloc[-1], values.min(), values.max(), values.mean())
                assert rows[name][0] == str(len(values)) == str(N_SETS)
                assert rows[name][1:6] == [format_quantity(value, *shown) for value in expected], (
                    position,
                    name,
                )
        newest = test.assessments("B").iloc[-1]
        info = test.info()
    hour = format_quantity(newest["due_h"])
    for name, value, limit in (
        ("Control chart", newest["mewma_statistic"], LIMIT_CHART),
        ("Squared distance D²", newest["distance_squared"], newest["limit_f_predictive"]),
    ):
        texts = [format_number(value), format_number(limit)]
        assert ["B", "alarm", name, *texts, newest["quality"], hour, "1"] in page.tables["Status"]
    identity = {row[0]: row[1] for row in page.tables["Identity"]}
    assert identity["Configuration"] == f"SHA-256 {info['configuration_hash']}"


def test_the_summary_has_findings_alarms_actions_and_reliability(filled, page):
    words = " ".join(page.words)
    rows = filled.catalogue.rows(SetRow)
    n_done = sum(row.state == "done" for row in rows)
    assert f"{n_done} of {len(rows)} scheduled sets are complete" in words
    assert "The rig is simulated: no real wall was measured." in words
    assert "Alarms are active at B, C." in words
    alarms = sorted(filled.catalogue.rows(AlarmRow, active=True), key=lambda row: row.raised_h)
    listed = page.tables["Active alarms and actions"][1:]
    assert [row[:2] for row in listed] == [
        [row.priority.capitalize(), describe_alarm(row).headline] for row in alarms
    ]
    assert [row[4] for row in listed] == [describe_alarm(row).action for row in alarms]
    assert [row[2] for row in listed] == [
        "hour 5.5 (2024-01-01 05:30 UTC)",
        "hour 26.5 (2024-01-02 02:30 UTC)",
    ]
    reliability = {row[0]: row[1:] for row in page.tables["Reliability of the findings"]}
    rate = "design rate 0.2 per transducer-year"
    assert reliability["B"] == [
        "56 complete",
        f"{rate}, not verified: 48 sets, 150 needed",
        "wall 97 %, sensor 1 % (hour 28.0)",
        "48 sets, not reviewed",
    ]
    assert reliability["C"][1:] == [f"{rate}, verified", "not available", "48 sets, approved by ann"]
    assert reliability["A"][1] == "alarm at 3 of 5 sets"
    assert reliability["D"][0] == "56 complete, 3 missed"
    assert page.ids.index("reliability") < page.ids.index("identity"), "the appendix comes last"


def test_a_rate_is_described_with_the_reason_why_it_is_not_verified():
    macros = _create_environment().get_template("macros.html.j2").module

    def describe(baseline, alarms):
        return as_shown(str(macros.false_alarm_rate(baseline, alarms, 150)))

    quality = {"n": 150, "false_alarms_per_sensor_year": 0.5, "rate_verified": False}
    row = frozen_baseline("B", baseline_quality={**quality, "rate_not_verified_reason": "a trend"})
    alarms = Settings().alarms
    assert describe(row, alarms) == "design rate 0.5 per transducer-year, not verified: a trend"
    assert describe(None, alarms) == describe(frozen_baseline("B"), alarms) == "not available"
    by_count = alarms.model_copy(update={"decides_by": "k_of_n"})
    assert describe(row, by_count) == "no design rate: alarm at 3 of 5 sets"


def test_hostile_text_is_shown_as_text(tmp_path):
    evil = "<script>alert(1)</script><img src=x onerror=alert(1)>"
    settings = Settings(name=evil, positions={"B": {"label": evil, "method": "solitary_wave"}})
    with filled_folder(tmp_path, settings, sets=1) as folder:
        alarm = folder.add_alarm("B", 0, message=evil, evidence={evil: evil})
        command_id = folder.catalogue.add_command(
            evil, "acknowledge_alarm", {"alarm_id": alarm, "note": evil}
        )
        folder.acknowledge(alarm, folder.catalogue.command(command_id))
        folder.annotate(0.5, evil, position="B")
        make_report(tmp_path, "--out", tmp_path / "out.html")
    page = Page((tmp_path / "out.html").read_bytes())
    assert page.loaded == []
    assert sum(evil in word for word in page.words) > 8


def decides(alarms):
    macros = _create_environment().get_template("macros.html.j2").module
    page = Page(str(macros.alarm_rules(Settings(alarms=alarms))).encode())
    return dict(page.tables[""])


def test_methods_calibration_and_an_assumed_delay_are_stated(tmp_path):
    calibration = {"calibrated_on": "2026-01-15", "due_on": "2026-01-16", "sensitivity_v_per_n": 0.5}
    positions = {
        "A": {"method": "pulse_echo"},
        "B": {"method": "solitary_wave", "calibration": {**calibration, "certificate": "<7>"}},
    }
    settings = Settings(name="a <b> & c", positions=positions)
    with filled_folder(tmp_path, settings, shots_per_set=2) as folder:
        folder.add_set(0)
        times_s = [row.tof_pp_s for row in folder.catalogue.rows(FeatureRow, scope="shot")]
        printed = make_report(tmp_path, "--methods").stdout
        assert (
            make_report(tmp_path, "--methods", "--json").stdout
            == json.dumps({"ok": True, "methods": printed.rstrip("\n")}) + "\n"
        )
        make_report(tmp_path, "--out", tmp_path.parent / "report.html")
    page = Page((tmp_path.parent / "report.html").read_bytes())
    assert printed.rstrip("\n") in page.words
    assert printed.startswith('The test "a <b> & c" was recorded with solimon 0 on the rig simulated (a')
    assert "every 0.5 h until hour 75, then every 1 h until hour 350. At B, a set" in printed
    assert "with a probe delay of 8.00 µs, which is assumed. The uncertainty" in printed
    assert "sensor of B was calibrated on 2026-01-15 (certificate <7>), sensitivity 0.5 V/N.\n" in printed
    assert page.tables["Position B"][1][-1] == f"{1e6 * abs(times_s[0] - times_s[1]) / 2.0:.2f} µs"
    identity = page.tables["Identity"]
    assert ["Probe delay", "8.00 µs, assumed"] in identity
    assert ["2026-01-15, <7>", "2026-01-16 (overdue)", "0.500 V/N"] in [row[4:] for row in identity]


def test_the_report_describes_the_configured_alarm_rule():
    by_chart = decides({"false_alarms_per_sensor_year": 0.5})
    assert by_chart["Alarm rule"].startswith(
        "MEWMA control chart above its limit (design rate 0.5 per transducer-year)"
    )
    assert by_chart["Outlier limit"].endswith("an outlier alone raises no alarm")
    assert decides({"decides_by": "k_of_n", "k": 2, "n": 4}) == {
        "Alarm rule": "2 of 4 sets above the outlier limit",
        "Outlier limit": "f_predictive, 0.0027 false alarms per set",
    }


def test_each_figure_shows_each_set_where_it_belongs(filled):
    report_contents = read_report_contents(filled.folder)
    with client.open(filled.folder) as test:
        for place in report_contents.positions:
            columns = {"A": [("thickness_m", test.thickness("A"))]}.get(
                place.name,
                [
                    ("tof_pp_s", test.features(place.name)),
                    ("amplitude_ratio", test.features(place.name)),
                    ("distance_squared", test.assessments(place.name)),
                ],
            )
            svg = ElementTree.fromstring(draw_position_figure(report_contents, place))
            groups = {group.get("id"): group for group in svg.iter("{http://www.w3.org/2000/svg}g")}
            for name, table in columns:
                drawn = [
                    (float(use.get("x")), float(use.get("y")))
                    for use in groups[f"figure-{place.name}-{name}"].iter("{http://www.w3.org/2000/svg}use")
                ]
                assert len(drawn) == len(table) == N_SETS
                values = np.log(table[name]) if name == "distance_squared" else table[name]
                for along, expected in ((0, table["due_h"]), (1, values)):
                    coordinates = [point[along] for point in drawn]
                    slope, offset = np.polyfit(expected, coordinates, 1)
                    # SVG has six decimals of a point.
                    np.testing.assert_allclose(slope * expected + offset, coordinates, rtol=0, atol=1e-4)
                    assert (slope > 0) == (along == 0), "down is up"


def test_the_report_has_gaps_alarms_evidence_history_and_commands(page):
    assert [row for row in page.tables["Missed and incomplete sets"] if row[0] == "D"] == [
        ["D", "missed", "held", "28.50", "29.00", "2"],
        ["D", "missed", "held", "30.00", "30.00", "1"],
    ]
    alarm = find_alarm(page, 1)
    assert ["limit", "24.3"] in alarm
    shares = "Largest contributions: time of flight between the peaks 70 %, amplitude ratio 30 %."
    assert shares in page.words
    assert ["contributions", "tof_pp_s 21.4, amplitude_ratio 9.1"] in alarm
    assert [row[1:] for row in alarm if row[0] == "2024-01-02 02:30 UTC"][-1] == [
        "alarm acknowledged",
        "acknowledged",
        "ann",
        NOTE,
    ]
    shelved = find_alarm(page, 2)
    assert [row[1:] for row in shelved if row[0] == "2024-01-01 05:30 UTC"][-1] == [
        *("alarm shelved", "unacknowledged, shelved", "ann", "a new coil comes")
    ]
    states = [row[3] for row in page.tables["Active alarms and actions"][1:]]
    assert states == ["unacknowledged", f"acknowledged by ann: {NOTE}"], "its shelf has expired"
    assert page.tables["Annotations"][1:] == [
        ["3.00", "5.50", "B", "couplant <renewed>", "ann, 2024-01-01 00:30 UTC", ""],
        ["20.00", "20.00", "complete test", "door open", "ann, 2024-01-01 00:30 UTC", ""],
    ]
    (order,) = [row for row in page.tables["Commands"] if row[1] == "ann"]
    assert order[2:] == ["acknowledge alarm", f"alarm_id 1, note {NOTE}", "done", "acknowledged"]
    assert any(NOTE in word for word in page.words), "as it was written, and no markup"


def test_the_report_is_self_contained_with_unique_ids(page):
    assert page.loaded == []
    assert len(set(page.ids)) == len(page.ids)


def test_the_wall_has_the_interval_of_its_newest_reading(filled, page):
    newest = filled.catalogue.rows(ThicknessRow, position="A")[-1]
    wall, low, high = (
        f"{1e3 * value:.2f}" for value in (newest.thickness_m, newest.interval_low_m, newest.interval_high_m)
    )
    shown = f"Wall thickness {wall} mm (95 % interval {low} to {high} mm), limit 5.71 mm, quality good"
    assert f"{shown} (hour 28.0)." in page.words


def test_the_forecast_of_a_wall_is_drawn_to_its_hour_and_written(filled, page):
    assert "forecast for hour 35.0: 5.60 mm (5.20 to 6.10 mm)" in " ".join(page.words)
    report_contents = read_report_contents(filled.folder)
    drawn = {}
    for place in report_contents.positions[1:3]:
        svg = ElementTree.fromstring(draw_position_figure(report_contents, place))
        groups = {group.get("id"): group for group in svg.iter("{http://www.w3.org/2000/svg}g")}
        points = groups[f"figure-{place.name}-thickness_m"].iter("{http://www.w3.org/2000/svg}use")
        line = groups.get(f"figure-{place.name}-forecast")
        drawn[place.name] = [float(point.get("x")) for point in points], line
    assert drawn["C"][1] is None
    hours_x, line = drawn["B"]
    (path,) = line.iter("{http://www.w3.org/2000/svg}path")
    first, last = re.findall(r"[ML] ([\d.]+) ", path.get("d"))
    assert float(first) == pytest.approx(hours_x[-1], abs=1e-4), "it continues the newest set"
    per_h = (hours_x[-1] - hours_x[0]) / (0.5 * (len(hours_x) - 1))
    assert float(last) - float(first) == pytest.approx(7.0 * per_h, rel=1e-3)


def test_a_range_of_hours_can_be_chosen(filled, tmp_path):
    make_report(filled.folder, "--from-h", 5, "--to-h", 10, "--out", tmp_path / "part.html")
    part = Page((tmp_path / "part.html").read_bytes())
    rows = {row[0]: row for row in part.tables["Position B"]}
    with client.open(filled.folder) as test:
        values = test.features("B", from_h=5, to_h=10)["tof_pp_s"]
    assert rows["Time of flight"][1:4] == [
        *(
            str(len(values)),
            format_quantity(values.iloc[0], 1e6, 1, "µs"),
            format_quantity(values.iloc[-1], 1e6, 1, "µs"),
        )
    ]
    assert find_alarm(part, 2), "it was active then"
    assert not any(heading.startswith("Alarm 1:") for heading in part.tables), "it was raised later"
    assert [row[3] for row in part.tables["Annotations"][1:]] == ["couplant <renewed>"]


def test_a_configuration_selects_its_folder(filled, tmp_path):
    config = tmp_path / "test.toml"
    config.write_text(f"[storage]\nfolder = {json.dumps(str(filled.folder))}\n")
    answer = json.loads(make_report(config, "--out", tmp_path / "a.html", "--json").stdout)
    assert (answer["ok"], answer["n_bytes"]) == (True, (tmp_path / "a.html").stat().st_size)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("--from-h", 5, "--to-h", 5), "let it end later"), (("--from-h", 1e6), "let it end later")],
)
def test_an_impossible_report_is_rejected_and_nothing_is_written(arguments, message, filled, tmp_path):
    target = tmp_path / "a.html"
    with pytest.raises(UsageError, match=message):
        make_report(filled.folder, *arguments, "--out", target)
    assert not target.exists()
    target.write_text("older")
    with pytest.raises(UsageError, match="--overwrite"):
        make_report(filled.folder, "--out", target)
    assert target.read_text() == "older"


def test_more_sets_than_a_page_shows_are_refused(filled, monkeypatch):
    monkeypatch.setattr(contents, "MOST_SETS", N_SETS - 1)
    with pytest.raises(UsageError, match=f"more than {N_SETS - 1} sets in this range"):
        read_report_contents(filled.folder)
    assert len(read_report_contents(filled.folder, to_h=20.0).positions) == 4


def test_without_the_extra_the_service_names_it(api, tmp_path, monkeypatch):
    """The report is made in a process of its own."""
    monkeypatch.setenv("PYTHONPATH", environment_without(tmp_path / "site", "matplotlib")["PYTHONPATH"])
    answer = api.get("/api/v1/report")
    assert (answer.status_code, answer.headers["content-type"]) == (501, "application/problem+json")
    problem = answer.json()
    assert problem["type"] == "urn:solimon:problem:missing-extra"
    assert problem["detail"] == (
        'Reports need figures; matplotlib is not installed: pip install "solimon[report]".'
    )


def test_the_service_makes_one_at_a_time_and_shows_the_audit_to_admins_alone(filled, monkeypatch):
    tokens = {
        role: create_token(filled.folder / "tokens.json", role, role)[1] for role in ("viewer", "admin")
    }
    with served(filled.settings, filled.folder) as service:
        with service.client(Authorization=f"Bearer {tokens['viewer']}") as api:
            answer = api.get("/api/v1/report?from_h=5&to_h=10")
            assert answer.headers["content-type"].startswith("text/html")
            assert "attachment" in answer.headers["content-disposition"]
            report = Page(answer.content)
            assert "Position B" in report.tables
            assert "audit" not in report.ids
            # The next ones without a process of their own, whose start is most of what they take.
            monkeypatch.setattr(route, "start_one_worker", lambda: nullcontext(AtOnce()))
            refused = api.get("/api/v1/report?from_h=5&to_h=5")
            assert (refused.status_code, "let it end later" in refused.text) == (422, True)
            with route._making:
                busy = api.get("/api/v1/report")
                assert (busy.status_code, busy.headers["retry-after"]) == (503, "1")
        with service.client(Authorization=f"Bearer {tokens['admin']}") as api:
            assert "audit" in Page(api.get("/api/v1/report?from_h=5&to_h=10").content).ids


def test_annotations_are_drawn_where_they_begin_and_end(filled):
    report_contents = read_report_contents(filled.folder)
    drawn = {
        place.name: draw_position_figure(report_contents, place).count(GREEN.lower())
        for place in report_contents.positions
    }
    # In each panel: an instant of the whole test everywhere, both ends of the range at B alone.
    assert drawn == {"A": 1, "B": 3 * 4, "C": 4, "D": 4}


def test_text_of_a_figure_is_text(filled):
    report_contents = read_report_contents(filled.folder)
    assert re.search(
        r"<text[^>]*>[^<]*time of flight", draw_position_figure(report_contents, report_contents.positions[1])
    )
