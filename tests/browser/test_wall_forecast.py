"""The forecast of a wall thickness in its chart: drawn, in words, after the hours of the other charts."""

import pytest
from support.browser_pages import at_hour, dashboard, expect, query, show, watched_pages
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

pytestmark = pytest.mark.browser

N_SETS = 110
MINIMUM_M = 5.2e-3
AHEAD = 1.5
"""Hour of the forecast, of that of the newest set: after the hours that the other charts show."""


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("wall")) as folder:
        usual = folder.wall

        def with_forecast(position, hour):
            row = usual(position, hour)
            now_m = row["thickness_m"]
            ahead = {"forecast_h": AHEAD * hour, "forecast_m": now_m - 0.35e-3, "minimum_m": MINIMUM_M}
            ends = {"forecast_low_m": now_m - 0.9e-3, "forecast_high_m": now_m - 0.05e-3}
            return row | (ahead | ends if position == "B" else {})

        folder.wall = with_forecast
        for index in range(N_SETS):
            folder.add_set(index)
        yield folder


@pytest.fixture(scope="module")
def page(filled, browser):
    with served(filled.settings, filled.folder) as running, watched_pages(browser) as open_:
        page = open_(f"{running.url}?position=B")
        until(lambda: dashboard(page, "charts.thickness?.drawn"), "the thickness is drawn")
        yield page


def test_the_forecast_follows_the_newest_set_up_to_its_hour_with_the_minimum(filled, page):
    hour = filled.due[N_SETS - 1].due_h
    wall = filled.wall("B", hour)
    until(lambda: dashboard(page, "charts.thickness.forecasts.length") == 1, "the forecast is drawn")
    chart = dashboard(page, "charts.thickness")
    (forecast,) = chart["forecasts"]
    assert forecast["hours"] == pytest.approx([hour, AHEAD * hour])
    for name, now in (("low", "interval_low_m"), ("median", "thickness_m"), ("high", "interval_high_m")):
        ahead = "forecast_m" if name == "median" else f"forecast_{name}_m"
        assert forecast[name] == pytest.approx([1e3 * wall[now], 1e3 * wall[ahead]])
    assert set(chart["y"]["minimum"]) == {1e3 * MINIMUM_M}


def test_only_the_chart_of_the_thickness_reaches_into_the_future(filled, page):
    ahead_h = AHEAD * filled.due[N_SETS - 1].due_h
    assert dashboard(page, "charts.thickness.span") == pytest.approx([0.0, ahead_h])
    assert dashboard(page, "charts.tof.span") == [0.0, 72.0], "as without a forecast"
    until(lambda: dashboard(page, "waterfall.ready"), "the waterfall is drawn")
    assert dashboard(page, "waterfall.hours") == [0.0, 72.0]


def test_the_cursor_of_the_other_charts_is_at_the_same_hour_and_hidden_in_the_future(page):
    line = page.locator("#tof .u-cursor-x")
    for hour, index, is_hidden in ((30.0, 59, False), (78.0, N_SETS - 1, True)):
        x, y = at_hour(page, "thickness", hour)
        page.mouse.move(x - 3, y)
        page.mouse.move(x, y)
        until(lambda index=index: dashboard(page, "charts.tof.cursor") == index, "it follows")
        assert dashboard(page, "charts.thickness.cursor") == index
        assert ("u-off" in line.get_attribute("class").split()) is is_hidden
    x, y = at_hour(page, "tof", 30.0)
    page.mouse.move(x - 3, y)
    page.mouse.move(x, y)
    until(lambda: dashboard(page, "charts.thickness.cursor") == 59, "it follows back")


def test_a_zoom_is_one_of_all_charts_and_may_reach_into_the_future(page):
    for to_h in (50.0, 78.0):
        page.mouse.move(*at_hour(page, "thickness", 20.0))
        page.mouse.down()
        page.mouse.move(*at_hour(page, "thickness", to_h), steps=3)
        page.mouse.up()
        until(lambda: "from_h" in query(page), "it is in the address")
        span = dashboard(page, "charts.thickness.span")
        assert span == pytest.approx([20.0, to_h], abs=0.5)
        at_hour(page, "tof", 30.0)  # drawn when it gets on the screen
        assert dashboard(page, "charts.tof.span") == pytest.approx(span)
        page.get_by_role("button", name="Whole test").click()
        until(lambda: dashboard(page, "charts.tof.span")[1] == 72.0, "the complete test")
        at_hour(page, "thickness", 20.0)
        until(lambda: dashboard(page, "charts.thickness.span")[1] > 78.0, "with its forecast")


def test_the_forecast_is_stated_in_words_and_in_the_legend(filled, page):
    hour = filled.due[N_SETS - 1].due_h
    later_m = filled.wall("B", hour)["forecast_m"]
    text = f"forecast of B at hour {hour:.1f} (good) for hour {AHEAD * hour:.1f}: {1e3 * later_m:.2f} mm"
    assert text in page.locator("#thickness .plot").get_attribute("aria-label")
    expect(page.locator("#thickness .card-head p").first).to_contain_text(text)
    expect(page.locator("#thickness .legend")).to_contain_text("forecast, 5 to 95 %")


def test_thickness_relative_to_a_baseline_has_no_forecast_and_no_minimum(page):
    show(page, "?position=B&relative=1")
    until(lambda: dashboard(page, "charts.thickness?.forecasts.length") == 0, "it is relative")
    assert "minimum" not in dashboard(page, "charts.thickness.y")
