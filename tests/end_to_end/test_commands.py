"""The command line as a stranger uses it: whole processes, real signals, exit codes."""

import json
import os
import signal
import subprocess
import urllib.error
import urllib.request
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import pytest
from support.command_line import SOLIMON, first_match, solimon_here
from support.small_experiment import rows_of
from support.waiting import until

from daq_service.archive import FolderSetReader

# A coarse mesh and half of the strikes: these tests are about processes.
QUICK = {
    "SOLIMON_PLATE__ELEMENTS_PER_EDGE": "16",
    "SOLIMON_SCHEDULE__SHOTS_PER_SET": "5",
    "SOLIMON_BASELINE__MINIMUM_VALID_SHOTS": "4",
    "SOLIMON_ALARMS__HOLE_SHOTS": "4",
}
LIMIT_S = 120.0
"""Far beyond any of these runs, on a loaded machine too: a hang ends in an error, not in silence."""

posix_only = pytest.mark.skipif(os.name == "nt", reason="Windows has neither SIGKILL nor SIGTERM")


@contextmanager
def started(*arguments):
    """Run a command in the background; end it with the test."""
    process = subprocess.Popen(
        [*SOLIMON, *arguments],
        env={**os.environ, **QUICK},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if os.name != "nt":
            # The whole group may have ended, as it should.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.communicate()


def sets_done(folder):
    return len(FolderSetReader(folder).sets())  # in the journal or in a file


def is_running(process_id):
    try:
        stat = Path(f"/proc/{process_id}/stat").read_text(encoding="ascii")
    except FileNotFoundError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def children_of(process_id):
    """Return the process id of each child by command (record, serve)."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            stat = (entry / "stat").read_text(encoding="ascii").rpartition(")")[2].split()
            command = (entry / "cmdline").read_bytes().split(b"\0")
        except (FileNotFoundError, ProcessLookupError):
            continue  # ended while we looked
        if int(stat[1]) == process_id and stat[0] != "Z":
            found |= {name: int(entry.name) for name in ("record", "serve") if name.encode() in command}
    return found


def answers(url):
    """Return whether the service has data: 503 until the first set is stored."""
    try:
        with urllib.request.urlopen(url, timeout=LIMIT_S):
            return True
    except urllib.error.HTTPError as error:
        if error.code != 503:
            raise
        return False


@posix_only
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_ctrl_c_and_sigterm_end_everything_without_a_kill(tmp_path, number):
    with started("demo", "--pace", "1", "--data-dir", str(tmp_path)) as process:
        url = first_match(process.stdout, r"http://127\.0\.0\.1:\d+")[0]
        until(partial(answers, f"{url}/readyz"), "its first set")
        children = children_of(process.pid)
        # To the whole group, as a terminal does.
        os.killpg(process.pid, number)
        assert process.wait(LIMIT_S) == 130
    assert not any(is_running(child) for child in children.values())
    log = (tmp_path / "logs" / "supervisor.log").read_text(encoding="utf-8")
    assert "did not leave" not in log, "each child left by itself before its time was up"
    stored = {row.set_index for row in rows_of(tmp_path)["sets"] if row.n_taken}
    assert len(stored) == sets_done(tmp_path), "every stored set has its rows"


def test_a_refusal_is_the_exit_code_and_the_last_words_of_the_process(tmp_path):
    config = tmp_path / "test.toml"
    config.write_text("[corrosion]\nsize_mm = 2.0", encoding="utf-8")
    command = [*SOLIMON, "record", str(config)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert (process.returncode, process.stdout) == (2, "")
    for command in ("record", "simulate"):
        assert process.stderr == solimon_here(command, str(config), env=QUICK).stderr


def test_check_config_counts_the_papers_experiment(tmp_path):
    facts = json.loads(solimon_here("check-config", "--json", "--data-dir", str(tmp_path), env={}).stdout)
    assert (facts["sets"], facts["strikes"], facts["pulse_echo_records"]) == (425, 12_750, 425)
    assert facts["end_utc"] == "2024-01-15T14:00:00.000Z"
    assert facts["free_bytes"] > 0


def test_simulate_gives_one_shot_or_a_table(tmp_path):
    shot = json.loads(solimon_here("simulate", "--json", "--depth", "0.4", env=QUICK).stdout)
    assert {"isw_peak_n", "isw_time_us", "psw_peak_n", "psw_time_us", "tof_us", "amplitude_ratio"} <= set(
        shot
    )
    assert shot["tof_us"] == pytest.approx(shot["psw_time_us"] - shot["isw_time_us"], rel=1e-12)
    table = solimon_here("simulate", "--depths", "0:0.8:3", env=QUICK).stdout.splitlines()
    assert [line.split()[0] for line in table[2:5]] == ["0.000", "0.400", "0.800"]
    assert shot["tof_us"] == pytest.approx(float(table[3].split()[5]), abs=0.005), "two decimals are printed"


def test_simulate_gives_zeners_impact_or_a_table():
    zener = ("simulate", "--model", "zener")
    impact = json.loads(solimon_here(*zener, "--json", "--depth", "0.4", env=QUICK).stdout)
    assert impact["amplitude_ratio"] == pytest.approx(impact["restitution"] ** 1.2, rel=1e-12)
    table = solimon_here(*zener, "--depths", "0:0.8:3", env=QUICK).stdout.splitlines()
    assert table[0].split() == ["depth", "lambda", "e", "tau_c", "ToF", "AR"]
    pristine, thinned, deep = (line.split() for line in table[2:5])
    assert [pristine[0], thinned[0], deep[0]] == ["0.000", "0.400", "0.800"]
    for key, cell in zip(
        ("inelasticity", "restitution", "contact_time", "tof_us", "amplitude_ratio"), thinned[1:], strict=True
    ):
        assert impact[key] == pytest.approx(float(cell), rel=5e-4), "four digits are printed"
    # lambda goes with h^-2: 0.6^-2 and 0.2^-2 of the pristine plate's, which has four printed digits.
    assert float(thinned[1]) / float(pristine[1]) == pytest.approx(1 / 0.36, rel=5e-4)
    assert float(deep[1]) / float(pristine[1]) == pytest.approx(25.0, rel=5e-4)
    dropped = json.loads(
        solimon_here(*zener, "--json", "--drop-height-m", "0.16", env=QUICK).stdout
    )  # 32 times as high as 5 mm: lambda goes with v^(1/5), v with the root of the height
    assert dropped["inelasticity"] / float(pristine[1]) == pytest.approx(2.0**0.5, rel=5e-4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--model", "zener", "--tilt-rad", "0.01"], "leave it out"),
        (["--model", "zener", "--depth", "0.97"], "at most 0.95"),
        (["--model", "herz"], "'coupled', 'zener'"),
        (["--depth", "0.97"], "at most 0.95"),
        (["--drop-height-m", "-0.005"], "greater than 0"),
        (["--depths", "0..0.8"], "first:last:count"),
        (["--depths", "0:1:3"], "at most 0.95"),
        (["--position", "Z"], "no position 'Z'"),
    ],
)
def test_simulate_refuses_impossible_parameters(arguments, words):
    done = solimon_here("simulate", *arguments, env=QUICK)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stdout == ""
