"""What changes a test, given on the page: each order names its consequence, and is never a single click."""

from dataclasses import replace

import pytest
from axe_playwright_python.sync_playwright import Axe
from support.browser_pages import expect, watched_pages
from support.filled_folder import filled_folder, frozen_baseline
from support.served_web import served

from daq_service.catalogue import SetCommit
from daq_service.settings.tree import Settings
from daq_service.web.auth.tokens import create_token

pytestmark = pytest.mark.browser

SUPPLY = {"line": {"port": "/dev/none"}, "identity": "MAKER,MODEL", "voltage_v": 9.0, "voltage_cap_v": 11.0}

BASELINE_QUALITY = {
    "n": 47,
    "n_left_out": 1,
    "n_eff": 33.6,
    "phi_pooled": 0.17,
    "tail": 1.5,
    "named": [{"kind": "group", "set_indices": [3, 4, 5]}, {"kind": "trend", "set_indices": [0, 47]}],
    "advice": "200 sets and more are advised, 47 are there",
    "false_alarms_per_sensor_year": 0.2,
    "rate_verified": False,
    "rate_not_verified_reason": "47 sets, 150 needed",
}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data"), Settings(rig={"supply": SUPPLY})) as folder:
        for index in range(3):
            folder.add_set(index, stored=False, shown=index == 2)
        folder.add_alarm("B", 2)
        retired = {"retired_by": "ben", "retired_reason": "coupled anew", "retired_utc_ns": folder.epoch_ns}
        second = {
            "name": "B-baseline-2",
            "state": "proposed",
            "approval": "by_a_person",
            "baseline_quality": BASELINE_QUALITY,
        }
        rows = [frozen_baseline("B", state="retired", **retired), frozen_baseline("B", **second)]
        folder.catalogue.commit_set(SetCommit(baselines=rows))
        yield folder


@pytest.fixture(scope="module")
def shared(service, browser):
    """Yield a page for commands that leave nothing behind, with the control card open."""
    with watched_pages(browser) as open_:
        page = open_(service.url, name="ann")
        page.get_by_text("Test control").click()
        yield page


def answered(filled, author="ann"):
    """Take the one waiting command as the recorder does; return its kind and arguments."""
    (command,) = filled.catalogue.list_open_commands()
    assert command.author == author
    filled.catalogue.finish_command(command.id, "done", "done")
    return command.kind, command.arguments


@pytest.mark.parametrize(
    ("button", "consequences", "confirm", "order"),
    [
        (
            "Stop test",
            ["Later sets are missed", "supply is switched off", "This page cannot undo it"],
            "Stop test",
            ("stop", {}),
        ),
        pytest.param(
            "Disable C",
            [
                "Position C is not struck after its current shot",
                "No sets come from it",
                "press Enable next to its notice",
            ],
            "Disable C",
            ("disable", {"position": "C", "note": ""}),
            marks=pytest.mark.slow,
        ),
        (
            "Supply on or new limits",
            [
                "the wall corrodes",
                "Ventilate the tank",
                "never switches on again by itself",
                "caps are 11 V and 2 A",
            ],
            "Switch on: 9 V, limit 1 A",
            ("supply_on", {"voltage_v": 9.0, "current_limit_a": 1.0, "note": ""}),
        ),
        pytest.param(
            "Supply off",
            ["Corrosion ends"],
            "Switch off",
            ("supply_off", {"note": ""}),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_command_states_its_consequence_and_needs_a_second_step(
    filled, shared, button, consequences, confirm, order
):
    page = shared
    control = page.locator("#control")
    asked, dialog = control.get_by_role("button", name=button, exact=True), page.get_by_role("dialog")
    asked.click()
    for text in consequences:
        expect(dialog).to_contain_text(text)
    expect(dialog.get_by_role("button", name="Cancel")).to_be_focused()
    page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)
    expect(asked).to_be_focused()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")  # on what has the focus: the safe choice
    expect(dialog).to_have_count(0)
    assert filled.catalogue.list_open_commands() == []
    asked.click()
    dialog.get_by_role("button", name=confirm).click()
    expect(control.get_by_role("button", name="Sent, expires")).to_be_visible()
    assert answered(filled) == order
    expect(asked).to_be_enabled()


def test_a_baseline_shows_its_quality_and_is_approved_or_renewed(filled, shared):
    page = shared
    card, dialog = page.locator("#baseline"), page.get_by_role("dialog")
    expect(card.locator("summary")).to_contain_text("Baseline of B Awaiting approval")
    card.locator("summary").press("Enter")
    for text in (
        "47 of 0 to 47, 1 left out",
        "34 independent sets (lag-1 autocorrelation 0.17)",
        "sets 3, 4, 5 form a separate group; a trend over the complete baseline",
        "not measured",
        "design rate 0.2 per transducer-year, not verified: 47 sets, 150 needed",
        "200 sets and more are advised",
        "Approve this baseline, or renew it with more sets.",
        "B-baseline-1, retired by ben, 2024-01-01",
    ):
        expect(card).to_contain_text(text)
    assert [rule["id"] for rule in Axe().run(page, context="#baseline").response["violations"]] == []
    card.get_by_role("button", name="Approve").click()
    expect(dialog).to_contain_text("healthy in sets 0 to 47")
    dialog.get_by_role("button", name="Approve B-baseline-2").click()
    expect(card.get_by_role("button", name="Sent, expires")).to_be_visible()
    assert answered(filled) == ("approve_baseline", {"position": "B", "note": ""})
    # Or it would be taken for the next order's.
    expect(card.get_by_role("button", name="Sent, expires")).to_have_count(0)
    renew = card.get_by_role("button", name="Renew baseline")
    renew.click()
    expect(dialog).to_contain_text("Until it is complete, the wall at B is not monitored")
    dialog.get_by_role("button", name="Retire B-baseline-2").click()
    expect(dialog).to_be_visible()
    assert filled.catalogue.list_open_commands() == [], "it needs a reason"
    dialog.get_by_label("Reason").fill("a new sensor")
    dialog.get_by_role("button", name="Retire B-baseline-2").click()
    expect(card.get_by_role("button", name="Sent, expires")).to_be_visible()
    assert answered(filled) == ("renew_baseline", {"position": "B", "note": "a new sensor"})
    page.locator('#tiles [data-position="C"]').click()
    expect(card).to_contain_text("C-baseline-1")
    expect(card).to_contain_text("3 of 48 (0 to 47)")
    expect(card).to_contain_text("hour 24.0")


def test_a_baseline_without_limits_is_shown_and_cannot_be_approved(filled, service, open_page):
    why = "a baseline of 14 sets; it needs 15"
    nothing = {
        "limit_f_predictive": None,
        "limit_mean_3sd": None,
        "distance_squared": None,
        "outlier": None,
        "limits": None,
    }
    refused = frozen_baseline(
        "D", id=4, state="proposed", limit_f_predictive=None, limits=None, limit_reason=why
    )
    assessment = replace(filled.assessment("D", 2, 1.5), **nothing, in_baseline=False, reason=why)
    filled.catalogue.commit_set(SetCommit(baselines=[refused]))
    filled.catalogue.commit_set(SetCommit(assessments=[replace(assessment, set_index=3)]))
    page = open_page(service.url, name="ann")
    tile, card = page.locator('#tiles [data-position="D"]'), page.locator("#baseline")
    expect(tile).to_contain_text("Not assessed")
    expect(tile).to_contain_text(why)
    tile.click()
    expect(card.locator("summary")).to_contain_text("Baseline of D No limits")
    card.locator("summary").press("Enter")
    expect(card).to_contain_text(why)
    expect(card.get_by_role("button", name="Renew baseline")).to_be_visible()
    expect(card.get_by_role("button", name="Approve")).to_have_count(0)


def test_the_supply_values_are_limited_by_the_caps_and_shown_on_the_button(filled, shared):
    page = shared
    page.get_by_role("button", name="Supply on or new limits").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Voltage in V").fill("12")
    dialog.get_by_role("button", name="Switch on: 12 V, limit 1 A").click()
    expect(dialog).to_be_visible()
    assert filled.catalogue.list_open_commands() == []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        found = Axe().run(page, context="#control, dialog[open]")
        assert found.violations_count == 0, found.generate_report()
    dialog.get_by_label("Voltage in V").fill("5.5")
    dialog.get_by_label("Current limit in A").fill("0.25")
    dialog.get_by_role("button", name="Switch on: 5.5 V, limit 0.25 A").click()
    expect(page.get_by_role("button", name="Sent, expires")).to_be_visible()
    assert answered(filled) == ("supply_on", {"voltage_v": 5.5, "current_limit_a": 0.25, "note": ""})


def test_a_name_is_requested_once_and_remembered(filled, service, open_page):
    page = open_page(service.url, name=None)
    hold, dialog = page.get_by_role("button", name="Pause", exact=True), page.get_by_role("dialog")
    for name in (None, "Ben B"):
        hold.click()
        dialog.get_by_label("Reason").fill("hands in the rig")
        page.keyboard.press("Enter")
        expect(dialog).to_contain_text("as claimed")
        if name is None:
            page.keyboard.press("Escape")
            expect(page.locator("#notice")).to_contain_text("it needs the name of its author")
            assert filled.catalogue.list_open_commands() == []
        else:
            page.keyboard.type(name)
            page.keyboard.press("Enter")
    expect(page.locator("#pause")).to_contain_text("Sent")
    assert answered(filled, "Ben B") == ("pause", {"note": "hands in the rig"})
    expect(page.get_by_role("button", name="Ben B (claimed)")).to_be_visible()
    page.reload()
    page.get_by_role("button", name="Pause", exact=True).click()
    dialog.get_by_label("Reason").fill("again")
    page.keyboard.press("Enter")
    expect(page.locator("#pause")).to_contain_text("Sent")
    assert answered(filled, "Ben B") == ("pause", {"note": "again"})
    page.get_by_role("button", name="Ben B (claimed)").click()
    dialog.get_by_label("Name").fill("Cleo")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Cleo (claimed)")).to_be_visible()


@pytest.mark.parametrize(("role", "held"), [("viewer", False), ("operator", True)])
def test_nothing_is_shown_without_a_token_and_no_button_that_its_role_does_not_allow(
    filled, open_page, tmp_path, role, held
):
    tokens = tmp_path / "tokens.json"
    _, text = create_token(tokens, "ann", role)
    settings = filled.settings.model_copy(
        update={"web": filled.settings.web.model_copy(update={"tokens_file": str(tokens)})}
    )
    with served(settings, filled.folder) as service:
        page = open_page(service.url, forgiven="401", name=None)
        dialog, tiles = page.get_by_role("dialog", name="Log in"), page.locator("#tiles [role=radio]")
        expect(dialog).to_be_visible()
        page.get_by_label("Token").fill("not one of ours")
        page.keyboard.press("Enter")
        expect(page.locator("#login-trouble")).not_to_be_empty()
        page.keyboard.press("Escape")
        expect(dialog).to_be_visible()
        expect(tiles).to_have_count(0)
        page.get_by_label("Token").fill(text)
        page.keyboard.press("Enter")
        expect(tiles).not_to_have_count(0)
        expect(page.locator("#connection")).to_have_text("Live")
        page.reload()
        expect(tiles).not_to_have_count(0)
        assert text not in page.url + str(page.evaluate("document.cookie + JSON.stringify(localStorage)"))
        page.get_by_text("Test control").click()
        buttons = page.locator("#control button:visible")
        expect(buttons).to_have_count(6)
        expect(page.locator("#pause")).to_be_visible(visible=held)
        expect(page.locator("#alarms [data-alarm]")).to_have_count(1)
        expect(page.locator("#notes")).to_have_attribute("data-count", "0")
        for order in ("Acknowledge:", "Shelve", "Add note"):
            expect(page.get_by_role("button", name=order)).to_be_visible(visible=held)
        assert not any(buttons.nth(n).is_enabled() for n in range(6))
        expect(page.locator("#control-reason")).to_have_text(f"ann is {role}: this role does not allow it.")
        expect(page.locator("#name")).to_be_hidden()
        expect(page.locator("#audit")).to_be_hidden()
        page.get_by_role("button", name=f"Log out ann ({role})").click()
        expect(dialog).to_be_visible()
        expect(tiles).to_have_count(0)
        page.close()
