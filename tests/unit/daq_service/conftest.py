"""A test that has everything which cannot be computed again, recorded once a process."""

import shutil
from dataclasses import replace

import pytest


@pytest.fixture(scope="session")
def life(tmp_path_factory):
    """Return the line of such a test; read-only."""
    from support.life_of_a_test import lived  # no other test needs it

    return lived(tmp_path_factory.mktemp("life"))


@pytest.fixture
def line(life, tmp_path):
    """Return the same line on a copy of its folder."""
    return replace(life, folder=shutil.copytree(life.folder, tmp_path / "copy"))
