"""Wall curves that no file holds are simulated beside the recorder, and reported."""

import logging
import threading
from dataclasses import replace

import pytest
from support.waiting import until

from daq_service.background import wall_curves
from daq_service.background.wall_curves import WallCurves
from daq_service.processes.installation import MissingExtraError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import PlateParameters

SHIPPED = ChainParameters(), PlateParameters()
OTHER = replace(ChainParameters(), drop_height_m=7e-3), PlateParameters()


def check_kinds(kinds):
    """Fail unless each missing kind comes once."""
    chain, _ = kinds[0]
    assert len(kinds) == 1
    assert chain.drop_height_m == 7e-3


def fail(kinds):
    raise SystemExit(3)


def wait_for_ever(kinds):
    threading.Event().wait()


def test_a_shipped_bank_starts_no_process():
    curves = WallCurves([SHIPPED, SHIPPED], fail)
    assert curves._process is None
    curves.run_for(1.0)
    curves.close()


@pytest.mark.parametrize(
    ("build", "text"),
    [(check_kinds, "the wall curves are there"), (fail, "no wall curves (exit code 3)")],
    ids=["built", "failed"],
)
def test_missing_curves_are_built_once_and_their_end_is_reported(caplog, build, text):
    caplog.set_level(logging.INFO)
    curves = WallCurves([SHIPPED, OTHER, OTHER], build)
    assert "simulating the wall curves of 1 transducers" in caplog.text

    def reported():
        curves.run_for(1.0)
        return curves._process is None

    until(reported, "the end of the process")
    assert text in caplog.text


def test_closing_ends_the_simulation():
    curves = WallCurves([OTHER], wait_for_ever)
    process = curves._process
    assert process.is_alive()
    curves.close()
    assert not process.is_alive()


def test_without_the_twin_the_extra_is_named(caplog, monkeypatch):
    def lack(*extras):
        raise MissingExtraError('numba is not installed: pip install "solimon[twin]"')

    monkeypatch.setattr(wall_curves, "require_extras", lack)
    curves = WallCurves([OTHER], fail)
    assert curves._process is None
    assert 'pip install "solimon[twin]"' in caplog.text
