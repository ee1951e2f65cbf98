"""The twin's waveform in the view of a set: on request, as soon as it is simulated, with its wall."""

import threading

import numpy as np
import pytest
from support.browser_pages import dashboard, expect, show, watched_pages
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

from daq_service.assessment.twin_waveform import SimulatedShot
from daq_service.background.twin_waveforms import TwinWaveforms

pytestmark = pytest.mark.browser

N_SETS = 52
CURVE = "solid, square 25.4 mm"
HALF_WAVE = SimulatedShot(
    step_s=1e-6, force_n=np.sin(np.pi * np.arange(66) / 65.0), isw_time_s=32.5e-6, isw_amplitude_n=1.0
)


@pytest.fixture(scope="module")
def page_and_event(tmp_path_factory, browser):
    """Yield a page of a service that simulates until the event is set, and the event."""
    is_simulated = threading.Event()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TwinWaveforms, "find", lambda self, shot: HALF_WAVE if is_simulated.is_set() else None)
        with filled_folder(tmp_path_factory.mktemp("twin"), shots_per_set=2) as folder:
            usual = folder.wall
            folder.wall = lambda position, hour: usual(position, hour) | {"curve": CURVE}
            for index in range(N_SETS):
                folder.add_set(index)
            with served(folder.settings, folder.folder) as running, watched_pages(browser) as open_:
                yield open_(f"{running.url}?position=B&set={N_SETS - 1}"), is_simulated


def labels(page):
    return [label for label in dashboard(page, "set")["labels"] if label.startswith("simulated")]


def test_the_twin_is_drawn_with_its_wall_and_follows_to_the_next_set(page_and_event):
    page, is_simulated = page_and_event
    until(lambda: dashboard(page, "set?.drawn"), "the waveforms are drawn")
    assert labels(page) == []
    twin = page.get_by_role("button", name="Simulated waveform of the twin")
    twin.click()
    expect(page.locator("solimon-set [role=status]")).to_have_text("The twin simulates this wall")
    is_simulated.set()
    until(lambda: labels(page), "it is simulated")
    (label,) = labels(page)
    assert label.startswith(f"simulated: {CURVE}; wall 6.")
    assert label.endswith("(hour 26.0, good), incident wave as measured")
    expect(page.locator("solimon-set .legend")).to_contain_text(label)
    shown = dashboard(page, "set")
    volts = np.array(shown["volts"][shown["labels"].index(label)])
    mark = next(one for one in shown["marks"] if one["name"].startswith("ISW"))
    mean_v = np.array(shown["volts"][-1])
    assert volts.size == mean_v.size
    assert abs(int(volts.argmax()) - int(mean_v.argmax())) <= 20, "2 µs"
    assert volts.max() == pytest.approx(mark["height_v"], rel=0.01)
    show(page, f"?position=B&set={N_SETS - 2}")
    until(lambda: "hour 25.5" in "".join(labels(page)), "it follows")
    twin.click()
    until(lambda: labels(page) == [], "it is taken away")
