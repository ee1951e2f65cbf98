"""The examples' drivers, installed as a laboratory would: the command of their pages, and a mixed rig."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.daqmx_models import running_brain
from support.daqmx_rig import CHAIN, HOUR_H, PLATE, QUICK_TWIN, coil_pulses_s, meet, quick_description, why_no
from support.small_experiment import run
from support.stored_files import read_set, set_files
from test_mixed_rigs import SHOTS, boards, mixed, set_rows

from hardware_drivers.measurement import ShotKey
from simulator.parameters.plate import CorrosionParameters
from simulator.shot.model import ShotModel
from simulator.specimen import Transducer, build_specimen

EXAMPLES = Path(__file__).parents[2] / "examples"
COMMANDS = {
    re.findall(r"--solimon-kind (\S+)", command)[0]: (example, command)
    for example in ("block_scope", "manual_striker")
    for command in re.findall(
        r"^    (pytest --pyargs .+)$", (EXAMPLES / example / "README.md").read_text("utf-8"), re.MULTILINE
    )
}
KEPT = {
    "block-scope": {"kind": "10 kept", "digitizer": "14 kept", "safety": "9 kept"},
    "hand-striker": {"kind": "10 kept", "striker": "3 kept"},
    "relay-striker": {"kind": "10 kept", "striker": "7 kept", "safety": "13 kept"},
}
"""Fewest rules that each suite tries on a double: skipped ones prove nothing."""


RATE_HZ = 10e6
KEY = ShotKey(position="C", set_index=0, shot_index=0)


def wave_of_the_twin_v():
    """Return the volts of a sensor on the physics twin, shape (n_samples,), at `RATE_HZ`."""
    transducer = Transducer(chain=CHAIN, model=ShotModel(CHAIN, PLATE, CorrosionParameters()))
    specimen = build_specimen(QUICK_TWIN, transducers={"C": transducer}, probed_thickness_m={})
    acquired = specimen.solitary_wave(KEY, HOUR_H)
    assert acquired is not None, "the twin's strike reaches the level"
    assert acquired.waveform.sample_rate_hz == RATE_HZ
    return acquired.waveform.volts()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return a folder with both packages, which are nowhere else on the path."""
    site = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    packages = []
    for example in ("block_scope", "manual_striker"):
        # Built from a copy: a build may write next to the sources.
        packages.append(tmp_path_factory.mktemp(example) / example)
        shutil.copytree(EXAMPLES / example, packages[-1], ignore=shutil.ignore_patterns("__pycache__"))
    done = subprocess.run(
        [*pip, "--no-compile", "--target", site, *packages], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return site


@pytest.mark.parametrize("kind", KEPT)
def test_an_example_keeps_every_rule_by_its_page_s_command(kind, site, tmp_path):
    example, command = COMMANDS[kind]
    for name in ("rig.toml", "tests"):
        source = EXAMPLES / example / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, tmp_path / name)
    done = subprocess.run(
        # In addition to the suites its own tests, which are named after it.
        [
            sys.executable,
            "-m",
            *shlex.split(command),
            *tmp_path.glob(f"tests/test_{kind.replace('-', '_')}.py"),
        ],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    counts = dict(re.findall(r"^(\w+): (\d+ kept, \d+ broken.*)$", done.stdout, re.MULTILINE))
    assert {suite: counts[suite].partition(",")[0] for suite in KEPT[kind]} == KEPT[kind]
    assert all(", 0 broken" in line for line in counts.values())
    assert f"solimon's rules: {kind}, solimon-{example.replace('_', '-')} 0.1.0" in done.stdout
    assert re.search(r"^tests.test_\w+\.py \.+", done.stdout, re.MULTILINE), "its own tests ran, too"


@pytest.mark.skipif(bool(why_no("library")), reason=why_no("library") or "the double can be built")
def test_a_mixed_rig_takes_a_set_by_the_example_s_scope_and_a_counter_of_ni(site, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(site))
    from block_scope import api
    from block_scope.double import ScopeDouble, as_library

    wave_v = wave_of_the_twin_v()
    with running_brain(quick_description()) as doubles:
        meet(doubles, monkeypatch)

        class ScopeNextToTheChassis(ScopeDouble):
            """Scope whose transducer is struck by the coil at the counter of a board."""

            strikes = 0

            def bs_is_ready(self, handle, ready):
                ended = [event for event in doubles.control.record()["lines"] if not event["level"]]
                if len(ended) > self.strikes:
                    self.strikes = len(ended)
                    self.wave_arrives(wave_v, RATE_HZ)
                return super().bs_is_ready(handle, ready)

        scope = ScopeNextToTheChassis()
        monkeypatch.setattr(api, "load", lambda name: as_library(scope))
        instruments = {
            "counter": boards(doubles, "C", input=""),
            "scope": {"kind": "block-scope", "channels": {"C": "A"}},
        }
        settings = mixed(instruments, {"C": ("scope", "counter")}, read_timeout_s=60.0)
        assert run(settings, tmp_path / "data")
        assert coil_pulses_s(doubles.control.record()) == pytest.approx([3e-3] * SHOTS)
    assert set_rows(tmp_path / "data")["C"].state == "done"
    stored = read_set(set_files(tmp_path / "data")[0])
    assert stored.provenance["rig_identity"]["scope"] == "block-scope, solimon-block-scope 0.1.0"
    assert len(stored.shots) == SHOTS
    for shot in stored.shots:
        recorded_v, code_v = shot.waveform.volts(), 5.0 / (2**13 - 1)
        # From the first code at the level on, as the scope's own comparator sees it, within half a code.
        begins = int(np.argmax(np.rint(wave_v / code_v) >= round(0.25 / code_v)))
        after_v = recorded_v[shot.waveform.pretrigger_samples :][: wave_v.size - begins]
        assert np.abs(after_v - wave_v[begins:][: after_v.size]).max() <= 0.5001 * code_v
