"""`solimon setup` from nothing to a first good set: a terminal, a page, doubles of the boards, no editor."""

import os
import re
import subprocess
from dataclasses import replace

import pytest
from support.browser_pages import PHONE, expect
from support.command_line import SOLIMON
from support.daqmx_rig import CHAIN, QUICK_TWIN, board, coil_pulses_s, quick_description
from support.pictures import DOCS, compress_picture
from support.pseudo_terminal import on_terminal
from support.waiting import until

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import FeatureRow, SetRow
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.transports.library import build_environment, build_library, find_unavailability_reason
from simulator.parameters.electronics import NoiseParameters

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(os.name == "nt", reason="Windows has no pseudo-terminal here"),
    pytest.mark.skipif(
        bool(find_unavailability_reason()), reason=find_unavailability_reason() or "it can be built"
    ),
]

QUICK = quick_description(board(), positions="B")
DESCRIPTION = replace(
    QUICK,
    transducers={
        name: replace(
            wiring,
            chain=replace(CHAIN, drop_height_m=5e-3),
            crosstalk=Crosstalk(on_v=0.4, off_v=0.8, decay_s=0.2e-3),
        )
        for name, wiring in QUICK.transducers.items()
    },
    twin=replace(QUICK_TWIN, noise=NoiseParameters()),
)
PULSE_S = 0.01
PICTURE = DOCS / "pictures" / "set-up.png"
ONE_SET = {
    "SOLIMON_SCHEDULE__PHASES": '[{"until_h": 0.0001, "interval_h": 0.0001}]',
    "SOLIMON_SCHEDULE__SHOTS_PER_SET": "2",
    "SOLIMON_SCHEDULE__SHOT_INTERVAL_S": "0.1",
    "SOLIMON_BASELINE__MINIMUM_VALID_SHOTS": "2",
    "SOLIMON_ALARMS__HOLE_SHOTS": "2",
}
"""The paper's schedule takes 350 hours; nothing else of the written file is changed."""


@pytest.mark.slow
def test_terminal_and_page_lead_from_nothing_to_a_first_good_set(doubles, open_page, tmp_path):
    file = tmp_path / "lab.toml"
    env = build_environment(doubles.wire, build_library("nidaqmx"))
    with on_terminal([*SOLIMON, "setup", str(file), "--no-browser"], env) as terminal:
        terminal.until(r"scope  http://127\.0\.0\.1:\d+/;")
        page = open_page(re.search(r"scope  (http://[\d.:]+/)", terminal.written)[1])
        form, answer = page.locator("#form"), page.get_by_role("button", name="Answer")
        strike = page.get_by_role("button", name="strike", exact=True)
        live, log = page.locator("#live"), page.locator("#log")

        def asks(name):
            expect(form).to_have_attribute("data-name", name)
            expect(form).to_be_visible()

        asks("name")
        page.locator("#answer").fill("Tank 3")
        answer.click()
        asks("drop_height_m")
        answer.click()
        terminal.until("Time a coil is on")
        terminal.enter(str(PULSE_S))
        asks("position")
        page.locator("#answer").fill("B")
        answer.click()
        for question in (
            "Board that records B",
            "Input of the PZT",
            "Counter of the coil",
            "Terminal at which",
        ):
            terminal.until(question)
            terminal.enter()
        # Free running: records come one after the other, and nothing strikes.
        asks("B.strike")
        until(lambda: int(live.get_attribute("data-frames") or 0) >= 3, "three records were drawn")
        assert "B at rest" in live.get_attribute("aria-label")
        assert doubles.control.record()["strikes"] == []
        assert coil_pulses_s(doubles.control.record()) == []

        strike.click()
        expect(page.locator("#strike")).to_have_attribute("data-strikes", "1")
        shot = page.locator("#shot").get_attribute("aria-label")
        assert re.fullmatch(r"ISW 2\.\d\d V at \d+\.\d µs; PSW 1\.\d\d V at 3\d\d\.\d µs", shot), shot
        expect(page.locator("#flags")).to_contain_text("flags: none")
        expect(log).to_contain_text("takes the trigger")
        terminal.until(r"B .* wave of 2\.\d+ V")
        terminal.until("Strike B once", times=2)
        assert coil_pulses_s(doubles.control.record()) == [pytest.approx(PULSE_S, abs=1e-8)]
        if os.environ.get("SOLIMON_TEST_PICTURES") == "keep":
            PICTURE.write_bytes(compress_picture(page.screenshot(), "the set-up page after a strike"))

        page.set_viewport_size(PHONE)
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        terminal.enter("continue")
        asks("position")
        answer.click()
        asks("accept")
        expect(log).to_contain_text("ranges B +-5 V")
        page.get_by_role("button", name="yes").click()
        for question in (
            "ultrasonic probe at A",
            "Serial port of the supply",
            "Serial port of a thermometer",
        ):
            terminal.until(question)
            terminal.enter()
        expect(page.locator("#question")).to_contain_text("is written")
        assert terminal.end() == 0, terminal.written

    before = len(coil_pulses_s(doubles.control.record()))
    environment = {**os.environ, **env, **ONE_SET}
    done = subprocess.run(
        [*SOLIMON, "record", str(file)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    with open_catalogue(tmp_path / "solimon-data") as catalogue:
        assert [row.state for row in catalogue.rows(SetRow)] == ["done"]
        (feature,) = catalogue.rows(FeatureRow, scope="set")
    assert (feature.quality, feature.n_valid) == ("good", 2)
    assert len(coil_pulses_s(doubles.control.record())) == before + 2, "no strike was repeated"
