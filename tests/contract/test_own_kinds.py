"""solimon's own kinds of instruments keep the rules of any kind, on their doubles."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from pydantic import TypeAdapter
from support.archived_sets import make_set
from support.daqmx_rig import parameters_of, quick_description, reach, why_no
from support.filed_archive import FiledArchive
from support.serial_rig import NO_TERMINALS, SerialRig
from support.small_experiment import small_settings

from hardware_drivers.conformance.bench import Bench, MachineClock
from hardware_drivers.conformance.kind_contract import KindContract
from hardware_drivers.conformance.safety_contract import SafetyContract
from hardware_drivers.kinds import Opening, Role
from hardware_drivers.plug_ins import find_kind

DESCRIPTION = quick_description()
on_boards = pytest.mark.skipif(bool(why_no("library")), reason=why_no("library") or "the double can be built")
on_terminals = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS or "there are pseudo terminals")


@dataclass(frozen=True, slots=True, kw_only=True)
class Own:
    """Built-in kind with its double."""

    name: str
    table: dict[str, Any]
    serves: dict[Role, tuple[str, ...]]
    experiment: dict[str, Any]


def plain(parameters):
    return TypeAdapter(type(parameters)).dump_python(parameters, mode="json")


@pytest.fixture
def daqmx(doubles, monkeypatch):
    reach("library", doubles, monkeypatch)
    struck = {"digitizer": ("C", "D"), "striker": ("C", "D")}
    yield Own(name="daqmx", table=plain(parameters_of(DESCRIPTION, doubles)), serves=struck, experiment={})
    record = doubles.control.record()
    assert (record["tasks"], record["reservations"]) == ([], {})


@pytest.fixture
def simulated():
    settings = small_settings(plate={"model": "infinite_kirchhoff"})
    serves = {"digitizer": ("B",), "striker": ("B",), "pulse_echo": ("A",)}
    return Own(name="simulated", table={}, serves=serves, experiment=settings.model_dump(mode="json"))


@pytest.fixture
def playback(tmp_path):
    FiledArchive(tmp_path).store_set(make_set())
    serves = {"digitizer": ("B",), "striker": ("B",), "pulse_echo": ("A",)}
    experiment = small_settings().model_dump(mode="json")
    return Own(name="playback", table={"source": str(tmp_path)}, serves=serves, experiment=experiment)


@pytest.fixture
def serial_rig(tmp_path):
    with SerialRig(tmp_path) as rig:
        yield rig


@pytest.fixture
def text_supply(serial_rig):
    return Own(
        name="text-supply", table=plain(serial_rig.supply_parameters), serves={"supply": ()}, experiment={}
    )


@pytest.fixture
def text_climate(serial_rig):
    return Own(
        name="text-climate", table=plain(serial_rig.climate_parameters), serves={"climate": ()}, experiment={}
    )


class OfOurs:
    """Answers to the queries of the conformance rules."""

    @pytest.fixture
    def kind(self, own):
        return find_kind(own.name)[0]

    @pytest.fixture
    def module(self, own):
        return next(iter(find_kind(own.name)[1].by_role.values())).module

    @pytest.fixture
    def table(self, own):
        return own.table

    @pytest.fixture
    def opening(self, own):
        return Opening(clock=MachineClock(), serves=own.serves, experiment=own.experiment, boot_id="test")

    @pytest.fixture
    def open_kind(self, kind, table, opening):
        parameters = TypeAdapter(kind.parameters).validate_python(table)
        return lambda: kind.open(parameters, opening)


class TestOurKinds(OfOurs, KindContract):
    @pytest.fixture(
        params=[
            pytest.param("daqmx", marks=on_boards),
            "simulated",
            "playback",
            pytest.param("text_supply", marks=on_terminals),
            pytest.param("text_climate", marks=on_terminals),
        ]
    )
    def own(self, request):
        return request.getfixturevalue(request.param)


@on_terminals
class TestTextInstrumentsAtAPulledCable(OfOurs, SafetyContract):
    test_after_an_error_nothing_is_armed = None  # they are no digitizers
    test_after_an_error_every_coil_is_off = None  # and have no coils

    @pytest.fixture(params=["text_supply", "text_climate"])
    def own(self, request):
        return request.getfixturevalue(request.param)

    @pytest.fixture
    def fault(self):
        return "unplugged"

    @pytest.fixture
    def bench(self, own, serial_rig):
        links = serial_rig.instruments.supply_link, serial_rig.instruments.climate_link

        @contextmanager
        def fault(name):
            for link in links:
                link.unplug()
            yield
            for link in links:
                link.plug()

        return Bench(fault=fault)
