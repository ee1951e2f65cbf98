"""An order from the command line reaches a recorder that runs."""

import threading
from collections import Counter

import pytest
from support.small_experiment import run, small_settings
from support.stored_files import set_files
from support.waiting import WAIT_S, until

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.rows import SetRow
from daq_service.commands.send import send_command
from daq_service.errors import UsageError


def states(folder):
    try:
        with open_catalogue(folder) as catalogue:
            return Counter(row.state for row in catalogue.rows(SetRow, position="D"))
    except NoDataYetError:
        return Counter()


def order(folder, kind, note="", position=None):
    return send_command(
        kind,
        config=None,
        data_dir=folder,
        note=note,
        author="ann",
        as_json=False,
        **({"position": position} if position else {}),
    )


def test_a_running_test_is_paused_resumed_and_a_transducer_disabled(tmp_path, capsys):
    folder, stop = tmp_path / "data", threading.Event()
    # Eight sets per second: slow enough for orders to be heard between them.
    paced = small_settings(
        clock={"pace_h_per_s": 4.0}, schedule={"phases": [{"until_h": 2000.0, "interval_h": 0.5}]}
    )
    recorder = threading.Thread(target=run, args=(paced, folder), kwargs={"stop": stop})
    recorder.start()
    try:
        until(lambda: states(folder)["done"] >= 2, "the second set")
        assert order(folder, "pause", "door open") == 0
        stored = sorted(set_files(folder))
        until(lambda: states(folder)["missed"] >= 3, "three missed sets")
        # A person may open the door after the answer: at most the set being stored then came after it.
        assert len(sorted(set_files(folder))) <= len(stored) + 1
        with pytest.raises(UsageError, match="already paused by ann: door open"):
            order(folder, "pause", "again")
        assert order(folder, "disable", position="D") == 0
        assert order(folder, "resume") == 0
        until(lambda: states(folder)["disabled"] >= 2, "two sets without D")
        assert order(folder, "enable", "new sensor", position="D") == 0
        done = states(folder)["done"]
        until(lambda: states(folder)["done"] > done, "another set of D")
    finally:
        stop.set()
        recorder.join(WAIT_S)
    assert not recorder.is_alive()
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == [
        "paused",
        "D is disabled",
        "resumed",
        "D strikes again from the next set",
    ]
