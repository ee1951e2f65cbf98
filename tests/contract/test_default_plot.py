"""Every HDF5 file opens as a plot: the chain of defaults by NeXus's rules, as H5Web and silx walk it."""

import h5py
import numpy as np
import pytest
import silx.io
import silx.io.nxdata
from click.testing import CliRunner
from support.earlier_folders import FOLDERS, unpack_folder
from support.filled_folder import filled_folder
from support.stored_files import set_files

from daq_service.catalogue import open_catalogue
from daq_service.cli.main import cli

EARLIER = sorted(path.name.removesuffix(".tar.xz") for path in FOLDERS.glob("*.tar.xz"))


@pytest.fixture(scope="module")
def today(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("today"), shots_per_set=2, sets=3, stored=True) as filled:
        yield filled.folder


@pytest.fixture(scope="module")
def folders(today, tmp_path_factory):
    found = {"today": today}
    for commit in EARLIER:
        found[commit] = tmp_path_factory.mktemp("earlier") / commit
        unpack_folder(commit, found[commit])
    return found


def text(value):
    return value.decode() if isinstance(value, bytes) else str(value)


def step(group, nx_class):
    """Follow the attribute `default` one level down."""
    name = text(group.attrs["default"])
    assert name in group, f"{group.name}@default leads to {name}"
    assert text(group[name].attrs["NX_class"]) == nx_class
    return group[name]


def check_plot(path):
    """Follow root@default to NXentry@default to NXdata@signal and @axes; return signal and axes names."""
    with h5py.File(path) as file:
        assert text(file.attrs["NX_class"]) == "NXroot"
        data = step(step(file, "NXentry"), "NXdata")
        name_of_signal = text(data.attrs["signal"])
        signal = data[name_of_signal]
        axes = [text(name) for name in np.atleast_1d(data.attrs["axes"])]
        assert len(axes) == signal.ndim
        assert np.issubdtype(signal.dtype, np.number)
        for name, length in zip(axes, signal.shape, strict=True):
            assert data[name].shape == (length,)
            # What has a unit says so; a number of a shot has none.
            assert name in ("shot_id", "sequence") or text(data[name].attrs["units"]) in ("s", "h")
        for name in np.atleast_1d(data.attrs.get("auxiliary_signals", [])):
            assert data[text(name)].shape == signal.shape
        expected = signal[()]
    with silx.io.open(str(path)) as file:
        shown = silx.io.nxdata.get_default(file)
        assert shown is not None, "silx finds no plot"
        assert shown.is_valid, shown.issues
        assert shown.is_curve or shown.is_image or shown.is_stack
        np.testing.assert_array_equal(shown.signal, expected)
    assert np.isfinite(expected).any()
    return name_of_signal, axes


@pytest.mark.parametrize("which", ["today", *EARLIER])
def test_the_file_of_a_set_opens_as_a_plot_for_any_writer(which, folders):
    files = set_files(folders[which])
    assert files
    for path in (files[min(files)], files[max(files)]):
        signal, axes = check_plot(path)
        assert (signal.endswith("_mean"), axes) == (True, ["time"])


@pytest.mark.parametrize("which", ["today", *EARLIER])
def test_the_file_of_a_whole_test_opens_as_a_plot(which, folders, tmp_path):
    if which in EARLIER:
        open_catalogue(folders[which], writer=True).close()  # as the start of a recorder does
    target = tmp_path / "all.h5"
    done = CliRunner().invoke(cli, ["export", "--data-dir", str(folders[which]), "--hdf5", str(target)])
    assert done.exit_code == 0, done.output
    assert check_plot(target) == ("waveform", ["shot_id", "time"])
