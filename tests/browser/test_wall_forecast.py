"""The forecast of a wall thickness in its chart: drawn, in words, within the hours of all charts."""

import pytest
from support.browser_pages import dashboard, expect, show, watched_pages
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

pytestmark = pytest.mark.browser

N_SETS = 110
MINIMUM_M = 5.2e-3


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("wall")) as folder:
        usual = folder.wall

        def with_forecast(position, hour):
            row = usual(position, hour)
            now_m = row["thickness_m"]
            ahead = {"forecast_h": 1.25 * hour, "forecast_m": now_m - 0.35e-3, "minimum_m": MINIMUM_M}
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
    assert forecast["hours"] == pytest.approx([hour, 1.25 * hour])
    for name, now in (("low", "interval_low_m"), ("median", "thickness_m"), ("high", "interval_high_m")):
        ahead = "forecast_m" if name == "median" else f"forecast_{name}_m"
        assert forecast[name] == pytest.approx([1e3 * wall[now], 1e3 * wall[ahead]])
    assert set(chart["y"]["minimum"]) == {1e3 * MINIMUM_M}
    assert chart["span"][1] >= forecast["hours"][1], "its hour is on the axis"
    assert dashboard(page, "charts.tof.span") == chart["span"]


def test_the_forecast_is_stated_in_words_and_in_the_legend(filled, page):
    hour = filled.due[N_SETS - 1].due_h
    later_m = filled.wall("B", hour)["forecast_m"]
    text = f"forecast of B at hour {hour:.1f} (good) for hour {1.25 * hour:.1f}: {1e3 * later_m:.2f} mm"
    assert text in page.locator("#thickness .plot").get_attribute("aria-label")
    expect(page.locator("#thickness .card-head p").first).to_contain_text(text)
    expect(page.locator("#thickness .legend")).to_contain_text("forecast, 5 to 95 %")


def test_thickness_relative_to_a_baseline_has_no_forecast_and_no_minimum(page):
    show(page, "?position=B&relative=1")
    until(lambda: dashboard(page, "charts.thickness?.forecasts.length") == 0, "it is relative")
    assert "minimum" not in dashboard(page, "charts.thickness.y")
