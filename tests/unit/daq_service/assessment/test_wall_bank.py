"""Banks of wall curves: the estimand's average, the shipped bank, the store."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from analysis.diagnosis.slopes import COMPONENTS, DAMPING, DROP_HEIGHT, GAIN, STIFFNESS
from analysis.errors import InvalidInputError
from analysis.wall.bank import ESTIMAND_RADIUS_M, FEATURES, load_bank
from daq_service.assessment import wall_bank
from daq_service.assessment.wall_bank import (
    RECORDER,
    SHIPPED_BANK,
    build_bank,
    compute_digest,
    compute_mean_loss,
    list_bank_arguments,
    list_members,
    open_bank,
    store_bank,
)
from daq_service.processes.installation import MODULES, MissingExtraError
from daq_service.settings.file import find_config_file, load_settings
from daq_service.settings.tree import WaveSettings
from hardware_drivers.methods import SOLITARY_WAVE
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PatchParameters, PlateParameters, SolidMesh

CHAIN, PLATE = ChainParameters(), PlateParameters()
SHORT = replace(CHAIN, spheres_above=3)
RADIUS = ESTIMAND_RADIUS_M
SAME_MODEL = 1e-4
"""Changes of ln features on other processors and libraries: reductions agree to some 1e-6."""


def segment(distance_m):
    """Area of the disc's part farther from its centre than a line, over the disc's."""
    x = distance_m / RADIUS
    return (math.acos(x) - x * math.sqrt(1.0 - x * x)) / math.pi


def cosine(diameter_m):
    """Mean of (1 + cos(pi r / R)) / 2 over the disc, by integration in closed form."""
    k = math.pi / (0.5 * diameter_m)
    return 0.5 + (RADIUS * math.sin(k * RADIUS) / k + (math.cos(k * RADIUS) - 1.0) / k**2) / RADIUS**2


@pytest.mark.parametrize(
    ("patch", "exact"),
    [
        ({"size_m": 25.4e-3}, 1.0),
        ({"size_m": 25.4e-3, "depth_factor": 0.4}, 0.4),
        ({"size_m": 15e-3}, 1.0 - 4.0 * segment(7.5e-3)),  # its corners are outside of the disc
        ({"size_m": 15e-3, "shape": "round"}, 0.75**2),
        ({"size_m": 4e-3, "shape": "round", "offset_x_m": 5e-3}, 0.2**2),
        ({"size_m": 40e-3, "offset_x_m": 20e-3}, 0.5),
        ({"size_m": 40e-3, "offset_x_m": 24e-3}, segment(4e-3)),
        ({"size_m": 60e-3, "shape": "rectangular", "size_y_m": 12e-3}, 1.0 - 2.0 * segment(6e-3)),
        ({"size_m": 50.8e-3, "shape": "round", "profile": "bowl"}, 1.0 - 0.5 * (RADIUS / 25.4e-3) ** 2),
        ({"size_m": 30e-3, "shape": "round", "profile": "cosine"}, cosine(30e-3)),
        ({"size_m": 200e-3, "offset_x_m": 250e-3}, 0.0),
    ],
    ids=str,
)
def test_the_loss_is_averaged_over_the_disc(patch, exact):
    # Elements of 50 um: a smooth profile is taken in their middles, a circle crosses 0.4 % of them.
    assert compute_mean_loss(CorrosionParameters(**patch)) == pytest.approx(exact, abs=2e-5)


def test_several_pits_add_up():
    pits = [
        PatchParameters(shape="round", size_m=4e-3, offset_x_m=x, depth_factor=0.5) for x in (6e-3, 30e-3)
    ]
    patch = CorrosionParameters(shape="round", size_m=6e-3, further=tuple(pits))
    assert compute_mean_loss(patch) == pytest.approx(0.3**2 + 0.5 * 0.2**2, abs=1e-5)


@pytest.fixture(scope="module")
def shipped():
    return load_bank(SHIPPED_BANK)


@pytest.mark.parametrize("name", ["simulated.toml", "laboratory.toml"])
def test_the_shipped_configurations_need_no_simulation(name, monkeypatch, tmp_path):
    monkeypatch.setitem(MODULES, "twin", ("no_such_module",))
    file = tmp_path / name
    file.write_text(find_config_file(name).read_text("utf-8").replace("PLACEHOLDER", "FFFFFFFF"), "utf-8")
    settings = load_settings(file)
    places = [settings.positions[place] for place in settings.list_positions(SOLITARY_WAVE)]
    assert places
    recorder = replace(
        RECORDER, adc=settings.twin.adc, tilt_loss_per_rad=settings.twin.sensor.tilt_loss_per_rad
    )
    for place in places:
        assert open_bank(place.chain, place.plate, recorder, folder=tmp_path) is not None


def test_the_shipped_bank_has_every_member_and_is_small(shipped):
    assert shipped.names == tuple(member.name for member in list_members(PLATE))
    assert len(set(shipped.names)) == len(shipped.names)
    assert set(shipped.models) == {"mindlin", "mindlin_circle", "wet_mindlin", "solid"}
    solid = {size for size, model in zip(shipped.sizes_m, shipped.models, strict=True) if model == "solid"}
    assert len(solid) >= 8
    assert min(solid) <= 15e-3
    assert max(solid) >= 70e-3
    assert shipped.losses[-1] >= 0.75
    assert SHIPPED_BANK.stat().st_size <= 2_000_000


def test_the_travel_time_grows_with_every_loss(shipped):
    for name, curve in zip(shipped.names, shipped.changes, strict=True):
        reached = np.isfinite(curve[:, 0])
        assert reached.sum() > 20, name
        assert np.isfinite(curve[reached]).all(), name
        assert not reached[reached.argmin() :].any() or reached.all(), name
        assert np.diff(curve[reached, 0]).min() > 0.0, name


def test_no_wall_changes_the_incident_wave(shipped):
    assert np.nanmax(np.abs(shipped.changes[:, :, 3:])) < 1e-6


def test_the_slopes_are_those_of_the_diagnosis(shipped):
    ours = [FEATURES.index(name) for name in FEATURES if name in COMPONENTS]
    theirs = [COMPONENTS.index(FEATURES[k]) for k in ours]
    tables = {"stiffness": STIFFNESS, "damping": DAMPING}
    rows = {f"{name}_{k}": row for name, table in tables.items() for k, row in enumerate(table)}
    rows |= {"drop_height": DROP_HEIGHT, "gain": GAIN}
    assert set(shipped.sources) == {*rows, "tilt_rad", "modulus_k"}
    for name, row in rows.items():  # printed with four decimals
        slopes = shipped.slopes[shipped.sources.index(name), ours]
        np.testing.assert_allclose(slopes, np.take(row, theirs), atol=6e-5, err_msg=name)


def test_gain_moves_the_height_alone(shipped):
    gain = shipped.slopes[shipped.sources.index("gain")]
    np.testing.assert_array_equal(gain, [0.0, 0.0, 0.0, 0.0, 1.0])


def test_members_are_built_again_with_the_same_curves(shipped):
    wanted = [
        "mindlin, square 25.4 mm",
        "mindlin circle, square 33 mm",
        "mindlin, square 20 mm, 3 x 3 pits",
    ]
    members = {member.name: member for member in list_members(PLATE)}
    seen = []
    bank = build_bank(
        CHAIN,
        PLATE,
        members=[members[name] for name in wanted],
        progress=lambda done, total, name: seen.append((done, total, name)),
    )
    assert seen == [(k, 3, name) for k, name in enumerate(wanted)]
    assert (bank.digest, bank.sources, bank.thickness_m) == (shipped.digest, shipped.sources, 6.35e-3)
    per_kelvin = bank.sources.index("modulus_k")
    np.testing.assert_allclose(bank.slopes, shipped.slopes, rtol=1e-3, atol=SAME_MODEL)
    np.testing.assert_allclose(bank.slopes[per_kelvin], shipped.slopes[per_kelvin], rtol=1e-2, atol=1e-7)
    for curve, name in zip(bank.changes, wanted, strict=True):
        stored = shipped.changes[shipped.names.index(name)]
        np.testing.assert_allclose(curve, stored, atol=SAME_MODEL)


@pytest.mark.parametrize(
    ("size", "loss"), [(25.4e-3, 0.2), (50.8e-3, 0.5)], ids=["25.4 mm, 20 %", "50.8 mm, 50 %"]
)
def test_a_solid_curve_is_that_of_plates_reduced_alone(shipped, size, loss):
    from simulator.shot.model import Impact, ShotModel

    solid = PlateParameters(model="solid", solid=SolidMesh())  # a reduction for each depth
    model = ShotModel(CHAIN, solid, CorrosionParameters(size_m=size))
    sound, thinned = (
        RECORDER.log_features(
            model.shots([Impact(depth_fraction=depth, tilt_rad=wall_bank.MEAN_TILT_RAD)])[0]
        )
        for depth in (0.0, loss)
    )
    stored = shipped.changes[shipped.names.index(f"solid, square {1e3 * size:.4g} mm")]
    at = int(np.argmin(np.abs(shipped.losses - loss)))
    # One basis for all depths leaves 2e-4, the spline between depths as much.
    np.testing.assert_allclose(thinned - sound, stored[at], atol=5e-4)


def test_a_patch_that_does_not_fit_is_no_member():
    small = replace(PLATE, width_m=0.05, height_m=0.05, elements_per_edge=32)
    members = list_members(small)
    assert 0.0 < max(member.size_m for member in members) <= 0.05
    assert len(members) < len(list_members(PLATE))


def test_the_digest_is_of_what_determines_the_curves():
    digest = compute_digest(CHAIN, PLATE, RECORDER)
    for same in (replace(PLATE, model="solid"), replace(PLATE, contact="patch")):
        assert compute_digest(CHAIN, same, RECORDER) == digest
    others = [
        (SHORT, PLATE, RECORDER),
        (CHAIN, replace(PLATE, thickness_m=6.3e-3), RECORDER),
        (CHAIN, PLATE, replace(RECORDER, tilt_loss_per_rad=8.0)),
        (CHAIN, PLATE, replace(RECORDER, adc=replace(RECORDER.adc, sample_rate_hz=5e6))),
    ]
    assert len({digest, *(compute_digest(*other) for other in others)}) == 1 + len(others)


def test_keys_of_a_position_that_override_its_chain_determine_its_curves():
    place = next(iter(load_settings(None).positions.values()))

    def arguments(**keys):
        return list_bank_arguments(place.model_copy(update={"waves": WaveSettings(**keys)}))

    plain = compute_digest(place.chain, place.plate, RECORDER)
    assert compute_digest(*arguments()) == plain
    assert compute_digest(*arguments(deepest_pull_fraction=0.2)) == plain, "it moves no curve"
    chain, plate, recorder = arguments(isw_fwhm_s=70e-6, psw_latest_s=800e-6)
    extraction = recorder.for_chain(chain).extraction
    assert (extraction.isw_fwhm_s, extraction.psw_latest_s) == (70e-6, 800e-6)
    both, one = compute_digest(chain, plate, recorder), compute_digest(*arguments(isw_fwhm_s=70e-6))
    assert len({plain, both, one}) == 3


def test_a_stored_bank_is_found_again_and_a_corrupt_one_is_reported(shipped, tmp_path, caplog):
    folder = tmp_path / "banks"
    assert open_bank(SHORT, PLATE, folder=folder) is None
    mine = replace(shipped, digest=compute_digest(SHORT, PLATE, RECORDER))
    store_bank(mine, folder)
    (file,) = folder.iterdir()
    found = open_bank(SHORT, PLATE, folder=folder)
    assert found is not None
    np.testing.assert_array_equal(found.changes, mine.changes)
    assert not caplog.records
    file.write_bytes(file.read_bytes()[:-100])
    assert open_bank(SHORT, PLATE, folder=folder) is None
    assert f"{file.name} is no intact wall bank" in caplog.text


def test_a_folder_that_cannot_be_written_is_reported(shipped, tmp_path, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    store_bank(shipped, blocked / "banks")
    assert "cannot store the wall bank" in caplog.text


def test_without_the_twin_the_error_names_its_extra(monkeypatch):
    monkeypatch.setitem(MODULES, "twin", ("no_such_module",))
    with pytest.raises(MissingExtraError, match=r"solimon\[twin\]"):
        build_bank(CHAIN, PLATE)


def test_too_few_depths_with_a_reflected_wave_make_no_curve(monkeypatch):
    monkeypatch.setattr(wall_bank, "DEPTHS", np.array([0.0, 0.5, 0.94, 0.95]))
    members = [member for member in list_members(PLATE) if member.kind == "nominal"]
    with pytest.raises(InvalidInputError, match=r"square 25\.4 mm: the twin's reflected wave is found at 2"):
        build_bank(CHAIN, PLATE, members=members)


def test_a_curve_ends_where_the_travel_time_stops_growing():
    depths = wall_bank.DEPTHS
    tof = np.where(
        depths < 0.61, depths, 1.2 - depths
    )  # as where another wave is taken for the reflected one
    rows = iter(np.outer(tof, np.ones(5)))
    recorder = SimpleNamespace(log_features=lambda force, tilt_rad: next(rows))
    model = SimpleNamespace(shots=lambda impacts: [None])
    member = next(member for member in list_members(PLATE) if member.kind == "nominal")
    curve = wall_bank._simulate_curve(CHAIN, member, model, recorder)
    reached = np.isfinite(curve[:, 0])
    assert wall_bank.LOSSES[reached][-1] == pytest.approx(0.6, abs=0.02)  # between two simulated depths
    assert not np.isfinite(curve[~reached]).any()
    assert np.diff(curve[reached, 0]).min() > 0.0


def test_a_record_that_ends_before_the_reflected_wave_is_refused():
    brief = replace(RECORDER, adc=replace(RECORDER.adc, record_samples=5_000))
    with pytest.raises(InvalidInputError, match="record longer"):
        build_bank(CHAIN, PLATE, brief)


def test_a_chain_that_lets_go_of_the_sensor_has_features(monkeypatch):
    """The end of its record is constant, which in a measured record means lost samples."""
    time_s = np.arange(0.0, 1.5e-3, 1e-7)
    pulses = sum(
        height * np.where(abs(time_s - at_s) < 44.5e-6, np.cos(np.pi * (time_s - at_s) / 89e-6) ** 4, 0.0)
        for at_s, height in ((1e-4, 30.0), (2.7e-4, 18.0))
    )
    chain = replace(CHAIN, radius_m=0.5 * CHAIN.radius_m, mass_kg=CHAIN.mass_kg / 8.0)
    shot = SimpleNamespace(time_s=time_s, force_n=pulses + 0.12 * (time_s < 1e-3), preload_n=0.12)
    assert np.isfinite(RECORDER.for_chain(chain).log_features(shot)).all()
    assert not np.isfinite(RECORDER.log_features(shot)).all(), "its windows are those of another wave"
