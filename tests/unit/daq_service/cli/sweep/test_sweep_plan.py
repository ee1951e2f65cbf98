"""Rows of a sweep: every combination once, checked by the bounds of the configuration."""

from dataclasses import fields, replace

import pytest

from daq_service.cli.sweep import plan as plan_module
from daq_service.cli.sweep.keys import ZENER_KEYS, list_known_keys
from daq_service.cli.sweep.plan import build_plan
from daq_service.cli.sweep.shot import compute_zener_impact
from daq_service.cli.sweep.specification import Axis, parse_axis
from daq_service.errors import UsageError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters

BASE = ChainParameters(), PlateParameters(), CorrosionParameters()


def planned(*specifications, **options):
    return build_plan("coupled", BASE, [parse_axis(text) for text in specifications], **options)


def test_a_grid_holds_every_combination_with_the_last_key_fastest():
    plan = planned("chain.sensor=sphere,disk", "corrosion.depth_fraction=0:0.4:3", "chain.spheres_below=3,4")
    assert len(plan.rows) == 12
    assert [row.index for row in plan.rows] == list(range(12))
    assert [row.values for row in plan.rows[:3]] == [
        ("sphere", 0.0, 3),
        ("sphere", 0.0, 4),
        ("sphere", 0.2, 3),
    ]
    chain, plate, corrosion = BASE
    expected = (replace(chain, sensor="disk", spheres_below=3), plate, replace(corrosion, depth_fraction=0.4))
    assert plan.rows[10].specimen == expected
    assert len({row.key for row in plan.rows}) == 12


def test_element_wise_takes_the_values_side_by_side():
    plan = planned("chain.drop_height_m=3e-3,4e-3", "chain.sensor=disk,sphere", element_wise=True)
    assert [row.values for row in plan.rows] == [(3e-3, "disk"), (4e-3, "sphere")]
    with pytest.raises(UsageError, match=r"chain\.drop_height_m 2, chain\.sensor 1"):
        planned("chain.drop_height_m=3e-3,4e-3", "chain.sensor=disk", element_wise=True)


def test_every_field_of_the_physics_is_a_key():
    for name, section in zip(("chain", "plate", "corrosion"), BASE, strict=True):
        for field in fields(section):
            assert f"{name}.{field.name}" in list_known_keys()


def test_whole_numbers_and_floats_take_the_type_of_their_key():
    (row,) = planned("chain.spheres_below=5:5:1", "chain.mass_kg=1:1:1,2", "chain.radius_m=0.05").rows[:1]
    assert [type(value) for value in row.values] == [int, float, float]
    with pytest.raises(UsageError, match=r"spheres_below: .*integer"):
        planned("chain.spheres_below=4.5")


@pytest.mark.parametrize(
    ("specifications", "message"),
    [
        (["chain.drop_hight_m=1"], r"did you mean chain\.drop_height_m\? All keys: chain\.radius_m, "),
        (["thickness_m=1"], r"did you mean plate\.thickness_m"),
        (["colour=1"], "is no key that can be swept; All keys"),
        (["chain.mass_kg=1", "chain.mass_kg=2"], "swept twice"),
        (["chain.drop_height_m=0.005,2"], r"row 2 \(chain\.drop_height_m = 2\) is refused: .*1 of 2 rows"),
        (["chain.sensor=cube"], "'sphere' or 'disk'"),
        (["plate.thickness_m=true"], "must be a number"),
        (["chain.mass_kg=nan"], r"mass_kg: .*\(value: nan\)"),
        (["chain.radius_m=9.5e-3,0.5"], r"row 2 .*density"),  # two values that contradict each other
        (["chain.mass_kg=0.02:0.03:500", "chain.radius_m=0.009:0.01:401"], "200500 rows; a sweep has at"),
    ],
)
def test_an_impossible_sweep_is_rejected_before_the_start(specifications, message):
    with pytest.raises(UsageError, match=message):
        planned(*specifications)


def test_waveforms_have_a_smaller_limit():
    with pytest.raises(UsageError, match="with --waveforms has at most 10000"):
        planned("chain.drop_height_m=0.003:0.008:10001", waveforms=True)


def test_rejected_combinations_can_be_rows_with_their_reason():
    plan = planned("chain.drop_height_m=0.005,2", "plate.thickness_m=-1,0.01", skip_invalid=True)
    assert [row.specimen is None for row in plan.rows] == [True, False, True, True]
    both = plan.rows[2].reason
    assert "chain: drop_height_m" in both
    assert "plate: thickness_m" in both
    assert plan.rows[2].values == (2, -1)


def test_the_identity_depends_on_parameters_keys_model_and_code(monkeypatch):
    axes = [Axis(key="chain.drop_height_m", values=(3e-3, 4e-3))]
    plan = build_plan("coupled", BASE, axes)
    chain, plate, corrosion = BASE
    assert build_plan("coupled", BASE, axes).identity == plan.identity
    heavier = build_plan("coupled", (replace(chain, mass_kg=28.3e-3), plate, corrosion), axes)
    identities = {
        plan.identity,
        heavier.identity,
        build_plan("zener", BASE, axes).identity,
        build_plan("coupled", BASE, axes, waveforms=True).identity,
        build_plan("coupled", BASE, [Axis(key="chain.drop_height_m", values=(4e-3, 3e-3))]).identity,
    }
    assert len(identities) == 5
    monkeypatch.setattr(plan_module, "compute_code_version", lambda: "another")
    changed = build_plan("coupled", BASE, axes)
    assert changed.identity not in identities
    assert changed.rows[0].key != plan.rows[0].key


def test_the_zener_model_accepts_only_its_keys():
    def numbers(key, value):
        (row,) = build_plan("zener", BASE, [Axis(key=key, values=(value,))]).rows
        assert row.specimen is not None
        return compute_zener_impact(*row.specimen)

    base = compute_zener_impact(*BASE)
    section = dict(zip(("chain", "plate", "corrosion"), BASE, strict=True))
    for key in ZENER_KEYS:
        table, name = key.split(".")
        value = getattr(section[table], name)
        changed = value + 1 if isinstance(value, int) else 1.01 * value or 0.1
        assert numbers(key, changed) != base, key
    for key in set(list_known_keys()) - set(ZENER_KEYS):
        with pytest.raises(UsageError, match="no influence on --model zener"):
            build_plan("zener", BASE, [Axis(key=key, values=(1,))])


def test_tables_below_a_section_are_swept_by_key_or_whole():
    by_key = planned("plate.liquid.density_kg_per_m3=1000,1025", "plate.liquid.depth_m=0.05")
    liquids = [row.specimen[1].liquid for row in by_key.rows if row.specimen is not None]
    assert [(item.density_kg_per_m3, item.depth_m) for item in liquids if item] == [
        (1000.0, 0.05),
        (1025.0, 0.05),
    ]
    whole = planned('plate.liquid=null,{"density_kg_per_m3": 1025, "depth_m": 0.05}')
    assert [row.specimen[1].liquid for row in whole.rows if row.specimen is not None] == [None, liquids[1]]
    with pytest.raises(UsageError, match=r"plate\.liquid is swept and plate\.liquid\.depth_m in it"):
        planned("plate.liquid=null", "plate.liquid.depth_m=0.05")
    with pytest.raises(UsageError, match=r"liquid\.depth_m: Field required"):
        planned("plate.liquid.density_kg_per_m3=1000")
