"""Common file readers: each finds the same names, units and numbers."""

import shutil
import subprocess

import h5py
import numpy as np
import pytest
import silx.io
import silx.io.nxdata
import xarray
from h5py import h5t
from support.archived_sets import LINEAR, SET_INDEX, make_set, other_set
from support.filed_archive import FiledArchive

from daq_service.archive.consolidated import Facts, build_consolidated_image, list_record_blocks
from daq_service.archive.layout import build_set_image

SHOTS = [shot for shot in make_set().shots if shot.key.position == "B"]
COUNTS = np.stack([shot.waveform.counts for shot in SHOTS])
OTHER_COUNTS = np.stack(
    [shot.waveform.counts for shot in other_set(make_set(), SET_INDEX + 1).shots if shot.key.position == "B"]
)
RESULTS = {
    "features": {
        "shot_id": [41, 43, 44],
        "position": ["B", "B", "C"],
        "tof_pp_s": [3.3e-4, np.nan, 3.4e-4],
        "flags": ["", "clipped noisy", ""],
    },
    "set_features": {"position": ["B", "C"], "tof_pp_s": [3.3e-4, 3.4e-4]},
}


needs_h5dump = pytest.mark.skipif(
    shutil.which("h5dump") is None, reason="h5dump is not installed (Debian package hdf5-tools)"
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("readers") / "set.h5"
    record = make_set()
    path.write_bytes(build_set_image(type(record)(**{**fields_of(record), "results": RESULTS})))
    return path


@pytest.fixture(scope="module")
def consolidated(tmp_path_factory):
    """Return one file of two sets."""
    folder = tmp_path_factory.mktemp("consolidated")
    archive, blocks = FiledArchive(folder), {}
    for record in (make_set(), other_set(make_set(), SET_INDEX + 1)):
        for sampling, block in list_record_blocks(folder, archive.store_set(record).file):
            blocks.setdefault(sampling, []).append(block)
    shots = {}
    for sampling, found in blocks.items():
        number = sum(len(block.shot_ids) for block in found)
        columns = {"tof_pp_s": np.linspace(3.3e-4, 3.4e-4, number), "flags": ["Ø", *[""] * (number - 1)]}
        shots[sampling] = (found, columns)
    sets = {"B": {"set_index": np.array([7, 8]), "due_h": np.array([4.0, 5.0]), "state": ["done", "partial"]}}
    facts = Facts(
        title="two sets",
        start_time="2024-01-01T00:00:00Z",
        maker_version="0.1.0",
        version="0.1.0",
        configuration_hash="ab" * 32,
        provenance={"configuration": {"name": "Ø"}},
    )
    path = folder / "all.h5"
    path.write_bytes(build_consolidated_image(path, folder, facts, shots, sets))
    return path


def fields_of(record):
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def test_xarray_shows_counts_as_counts_with_their_axes(path):
    with xarray.open_dataset(path, group="entry/B_waveforms", engine="h5netcdf") as data:
        waveform = data["waveform"]
        assert (waveform.dims, waveform.dtype, waveform.attrs) == (
            ("shot_time", "time"),
            np.int16,
            {"units": "counts"},
        )
        np.testing.assert_array_equal(waveform, COUNTS)
        assert {name: data[name].attrs["units"] for name in waveform.dims} == {"shot_time": "s", "time": "s"}
        np.testing.assert_array_equal(data["time"], SHOTS[0].waveform.time_s())
        volts = (waveform + data["waveform_offset"]) * data["waveform_scaling_factor"]
        # A few roundings of numbers up to 10 V.
        np.testing.assert_allclose(volts, LINEAR.volts(COUNTS), rtol=0, atol=10 * 8 * 2.0**-53)


def test_xarray_shows_volts_as_volts(path):
    with xarray.open_dataset(path, group="entry/preview", engine="h5netcdf") as preview:
        assert {curve.attrs["units"] for curve in preview.data_vars.values()} == {"V"}
        assert {curve.dims for curve in preview.data_vars.values()} == {("time",)}
        assert "long_name" not in preview["B_mean"].attrs, "a plot is labelled with the name and the unit"
        expected = LINEAR.volts(COUNTS).mean(axis=0)
        np.testing.assert_allclose(preview["B_mean"], expected, rtol=0, atol=10 * 2.0**-24)


def test_xarray_opens_every_group_without_making_up_a_dimension(path):
    tree = xarray.open_datatree(path, engine="h5netcdf")
    dimensions = {name: dict(node.ds.sizes) for name, node in tree.subtree_with_keys}
    assert dimensions["entry/positions"] == {"name": 4}
    assert dimensions["entry/missed"] == {"row": 3}
    assert not any("phony" in name for sizes in dimensions.values() for name in sizes)
    assert tree["entry/positions/name"].values.tolist() == ["A", "B", "C", "D"]
    assert tree["entry/positions/label"].values.tolist() == ["ultrasonic", "Ø 25.4 mm", "", ""]
    assert tree["entry"].ds["title"].item() == "Set 7, hour 4"
    tree.close()


def test_pandas_gets_the_tables(path):
    with xarray.open_dataset(path, group="entry/features", engine="h5netcdf") as features:
        table = features.to_dataframe()
    assert table.index.name == "shot_id"
    assert table["tof_pp_s"].to_dict() == pytest.approx({41: 3.3e-4, 43: np.nan, 44: 3.4e-4}, nan_ok=True)
    assert table["flags"].tolist() == ["", "clipped noisy", ""]
    assert table["position"].tolist() == ["B", "B", "C"]


def test_silx_plots_the_preview_with_its_units(path):
    with silx.io.open(str(path)) as file:
        preview = silx.io.nxdata.get_default(file)
        assert (preview.signal_name, preview.axes_names) == ("B_mean (V)", ["time (s)"])
        assert preview.title == "Mean, min and max of the shots"
        assert "C_mean" in preview.auxiliary_signals_names
        shots = silx.io.nxdata.NXdata(file["entry/B_waveforms"])
        assert shots.is_valid, shots.issues
        assert (shots.signal_name, shots.axes_names) == ("waveform (counts)", ["shot_time (s)", "time (s)"])
        np.testing.assert_array_equal(shots.signal, COUNTS)
        features = silx.io.nxdata.NXdata(file["entry/features"])
        assert (features.is_valid, features.signal_name) == (True, "tof_pp_s (s)")


def test_xarray_and_pandas_show_the_consolidated_file(consolidated):
    with xarray.open_dataset(consolidated, group="entry/B_waveforms", engine="h5netcdf") as data:
        waveform = data["waveform"]
        assert (waveform.dims, waveform.dtype, waveform.attrs) == (
            ("shot_id", "time"),
            np.int16,
            {"units": "counts"},
        )
        np.testing.assert_array_equal(waveform, np.vstack([COUNTS, OTHER_COUNTS]))
        assert data["shot_id"].values.tolist() == [41, 42, 43, 1041, 1042, 1043]
        volts = (waveform + data["waveform_offset"]) * data["waveform_scaling_factor"]
        assert volts.dims == ("shot_id", "time")
        np.testing.assert_allclose(volts[:3], LINEAR.volts(COUNTS), rtol=0, atol=10 * 8 * 2.0**-53)
        table = data[["tof_pp_s", "flags"]].to_dataframe()
        assert (table.index.name, table["flags"].tolist()[0]) == ("shot_id", "Ø")
    with xarray.open_dataset(consolidated, group="entry/B_sets", engine="h5netcdf") as sets:
        assert sets.to_dataframe()["state"].to_dict() == {7: "done", 8: "partial"}
        assert sets["due_h"].attrs["units"] == "h"
    tree = xarray.open_datatree(consolidated, engine="h5netcdf")
    assert not any("phony" in name for node in tree.subtree for name in node.ds.sizes)
    tree.close()


@needs_h5dump
def test_h5dump_reads_the_records_of_the_consolidated_file(consolidated, tmp_path):
    target = tmp_path / "counts.bin"
    command = ["h5dump", "-d", "/entry/B_waveforms/waveform", "-b", "LE", "-o", target, consolidated]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, cwd=tmp_path)
    assert done.stderr == ""
    found = np.frombuffer(target.read_bytes(), "<i2").reshape(6, 300)
    np.testing.assert_array_equal(found, np.vstack([COUNTS, OTHER_COUNTS]))


@pytest.mark.parametrize("kind", ["path", "consolidated"])
def test_matlab_s_rules_hold(kind, request):
    """No variable-length member of a compound, text of fixed length or UTF-8, superblock of HDF5 1.8."""
    with h5py.File(request.getfixturevalue(kind)) as file:
        assert file.id.get_create_plist().get_version()[0] == 2
        seen = set()

        def look(name, item):
            types = [("", item.id.get_type())] if isinstance(item, h5py.Dataset) else []
            types += [(key, item.attrs.get_id(key).get_type()) for key in item.attrs]
            for key, data_type in types:
                seen.add(data_type.get_class())
                assert key == "REFERENCE_LIST" or data_type.get_class() in SIMPLE, (name, key)
                if isinstance(data_type, h5t.TypeStringID):
                    assert data_type.get_cset() in (h5t.CSET_ASCII, h5t.CSET_UTF8), (name, key)
                    assert key or not data_type.is_variable_str(), name
                if isinstance(data_type, h5t.TypeCompoundID):
                    parts = [data_type.get_member_type(n) for n in range(data_type.get_nmembers())]
                    assert not any(part.get_class() == h5t.VLEN for part in parts), (name, key)

        file.visititems(look)
        assert {h5t.INTEGER, h5t.FLOAT, h5t.STRING} <= seen


SIMPLE = (h5t.INTEGER, h5t.FLOAT, h5t.STRING, h5t.VLEN)
"""VLEN: the references from an array to its axes, as netCDF-4 writes them; compounds: those back."""
