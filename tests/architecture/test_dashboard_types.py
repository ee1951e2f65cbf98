"""The dashboard's types: written as JSDoc, checked by TypeScript where it is installed."""

import shutil
import subprocess

import pytest

from daq_service.web.assets import FOLDER

TSC = shutil.which("tsc")


@pytest.mark.slow
@pytest.mark.skipif(TSC is None, reason="no tsc on the path (npm install --global typescript)")
def test_the_types_of_the_dashboard_hold():
    done = subprocess.run(
        [TSC, "--project", FOLDER / "jsconfig.json"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
