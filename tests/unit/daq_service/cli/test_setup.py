"""The parts of `solimon setup`: questions at terminal and page, guards of the page, detected instruments."""

import io
import os
import queue
import threading
from types import SimpleNamespace

import httpx2
import numpy as np
import pytest
import support.niscope_rig as probes
from support.serial_rig import NO_TERMINALS
from support.synthetic_records import waveform_of
from support.waiting import until

from daq_service.cli.set_up.bench import Bench
from daq_service.cli.set_up.dialogue import Dialogue, _Answer
from daq_service.cli.set_up.drawn import COLUMNS, compute_envelope
from daq_service.cli.set_up.other_instruments import ask_for_other_instruments
from daq_service.cli.set_up.page import serve_page
from daq_service.cli.set_up.wiring import find_default_terminal, list_coil_counters
from daq_service.errors import UsageError
from hardware_drivers.daqmx.parameters import TransducerWiring
from hardware_drivers.daqmx.survey import BoardFacts
from hardware_drivers.errors import ConfigurationError, InstrumentError
from simulator.doubles.serial.instruments import SerialInstruments

HEIGHT = {"name": "height", "text": "Height, m", "default": "0.005"}
LEAVE = {"name": "B.strike", "text": "Strike B", "default": "continue", "choices": ("strike", "continue")}


@pytest.fixture
def terminal(monkeypatch):
    """Return a terminal without input until a test writes some; it is closed at the end."""
    reading, writing = os.pipe()
    with os.fdopen(reading, encoding="utf-8") as ours, os.fdopen(writing, "w", encoding="utf-8") as theirs:
        monkeypatch.setattr("sys.stdin", ours)
        yield theirs
        theirs.close()
        until(lambda: "terminal" not in {item.name for item in threading.enumerate()}, "the terminal's end")


def bench(**values):
    nothing = {"strike": None, "shot": None}
    return SimpleNamespace(
        position=None, strikes=0, watch=lambda: (None, None), newest=lambda: nothing, **values
    )


def ask_in_thread(dialogue, question, understood=str):
    """Ask in another thread; return the queue of the answer."""
    value = queue.Queue()
    before = dialogue.number
    threading.Thread(target=lambda: value.put(dialogue.ask(**question, parse=understood))).start()
    until(lambda: dialogue.number > before, "the question")
    return value


# Questions -------------------------------------------------------------------------------------------


def test_a_question_is_repeated_until_the_answer_is_valid(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO("high\n0.01\n"))
    assert Dialogue().ask(**HEIGHT, parse=float) == 0.01
    assert "could not convert string to float: 'high'" in capsys.readouterr().err


def test_an_empty_answer_is_the_default_which_strikes_nothing(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("\nyes\nst\nstrike\n"))
    dialogue = Dialogue()
    assert dialogue.ask(**LEAVE, parse=str) == "continue"
    assert dialogue.ask(**LEAVE, parse=str) == "strike", "only the word itself"
    assert [line for line in dialogue.lines if "none of" in line] == [
        "  'yes' is none of strike, continue",
        "  'st' is none of strike, continue",
    ]


def test_the_end_of_the_input_is_reported_with_the_open_question(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with pytest.raises(UsageError, match=r"B\.strike: Strike B.*solimon setup --help"):
        Dialogue().ask(**LEAVE, parse=str)


def test_the_page_answers_the_question_that_waits_and_no_other(terminal):
    dialogue = Dialogue()
    assert not dialogue.answer(0, "strike"), "nothing is asked"
    value = ask_in_thread(dialogue, HEIGHT, float)
    shown = dialogue.as_row()["question"]
    assert (shown["name"], shown["default"], shown["choices"]) == ("height", "0.005", ())
    assert dialogue.answer(shown["number"], "0.004")
    assert value.get() == 0.004
    assert dialogue.as_row()["question"] is None
    value = ask_in_thread(dialogue, LEAVE)
    assert not dialogue.answer(shown["number"], "strike"), "that was an answer to the height"
    assert dialogue.answer(dialogue.number, "continue")
    assert value.get() == "continue"


def test_a_second_answer_to_one_question_does_not_answer_the_next(terminal):
    """Page and terminal answer at the same time: the later answer must not cause a strike."""
    dialogue = Dialogue()
    value = ask_in_thread(dialogue, HEIGHT, float)
    number = dialogue.number
    with dialogue._lock:  # it cannot end before both are under way
        dialogue._answers.put(_Answer("0.004", number))
        dialogue._answers.put(_Answer("strike", number))
    assert value.get() == 0.004
    value = ask_in_thread(dialogue, LEAVE)
    terminal.write("continue\n")
    terminal.flush()
    assert value.get() == "continue"


class Typed(io.StringIO):
    def isatty(self):
        return True


def test_input_typed_ahead_strikes_nothing(monkeypatch):
    typed = Typed("0.004\nstrike\n")
    monkeypatch.setattr("sys.stdin", typed)
    dialogue = Dialogue()
    assert dialogue.ask(**HEIGHT, parse=float) == 0.004
    until(lambda: "terminal" not in {item.name for item in threading.enumerate()}, "both lines were typed")
    with pytest.raises(UsageError, match="no answer is left"):
        dialogue.ask(**LEAVE, parse=str)


# The page --------------------------------------------------------------------------------------------


def test_the_page_is_guarded_as_the_dashboard(terminal):
    dialogue = Dialogue()
    with serve_page(dialogue, bench(), 0) as address, httpx2.Client(base_url=address) as api:
        assert address.startswith("http://127.0.0.1:")
        page = api.get("/")
        assert "solimon setup" in page.text
        assert "script-src 'self'" in page.headers["Content-Security-Policy"]
        assert api.get("/static/setup.js").status_code == 200
        assert api.get("/static/../server.py").status_code == 404
        value = ask_in_thread(dialogue, LEAVE)
        body = {"number": dialogue.number, "text": "strike"}
        foreign = {"Origin": "http://elsewhere.example"}
        assert api.post("/api/answer", json=body, headers=foreign).status_code == 403
        assert api.post("/api/record", headers=foreign).status_code == 403
        assert api.get("/api/state", headers={"Host": "elsewhere.example"}).status_code == 400
        assert value.empty()
        assert api.post("/api/answer", json={**body, "number": 0}).status_code == 409
        assert api.post("/api/answer", json=body).json() == {"taken": True}
        assert value.get() == "strike"
        assert api.post("/api/record").json() == {"position": None, "record": None}
        assert api.get("/api/strike").json() == {"strike": None, "shot": None}


def test_an_open_page_is_notified_of_the_end():
    with serve_page(Dialogue(), bench(), 0) as address:
        assert not httpx2.get(f"{address}api/state").json()["done"]
        heard = queue.Queue()

        def follow():
            with httpx2.Client(base_url=address) as api:
                while not api.get("/api/state").json()["done"]:
                    pass
            heard.put(True)

        threading.Thread(target=follow).start()
    assert heard.get()


def test_an_error_of_the_boards_is_shown_on_the_page():
    def refused():
        raise InstrumentError("LabVIEW holds the board; end it")

    watched = bench()
    watched.watch = refused
    with serve_page(Dialogue(), watched, 0) as address:
        assert httpx2.post(f"{address}api/record").json() == {
            "position": None,
            "error": "LabVIEW holds the board; end it",
        }


def test_an_envelope_keeps_every_crest():
    volts = np.zeros(13_600)
    volts[4321], volts[9876] = 4.0, -3.0
    drawn = compute_envelope(waveform_of(volts), first_s=-1e-4)
    assert len(drawn["highest_v"]) == len(drawn["lowest_v"]) == COLUMNS
    # Half a code of the converter.
    assert max(drawn["highest_v"]) == pytest.approx(4.0, abs=2e-4)
    assert int(np.argmin(drawn["lowest_v"])) == 9876 * COLUMNS // 13_600
    assert drawn["column_s"] * COLUMNS == pytest.approx(1.36e-3)


# Detected instruments --------------------------------------------------------------------------------


def test_a_counter_s_home_is_its_family_s():
    facts = {
        "serial": "1", "product": "", "device": None, "simulated": False, "ours": False,
        "max_rate_hz": 1e7, "ranges_v": (),
        "inputs": (), "analog_trigger": True, "calibrates_itself": True, "calibration_date": "",
        "calibration_temperature_c": 0.0, "temperature_c": 0.0, "name": "Dev1",
        "counters": ("Dev1/ctr0", "Dev1/ctr1", "Dev1/freqout"),
    }  # fmt: skip
    x_series = BoardFacts(terminals=("/Dev1/PFI12", "/Dev1/PFI13"), **facts)
    s_series = BoardFacts(terminals=("/Dev1/PFI12", "/Dev1/Ctr0Out", "/Dev1/Ctr1Out"), **facts)
    assert list_coil_counters(x_series) == ["ctr0", "ctr1"]
    assert [find_default_terminal(x_series, item) for item in ("ctr0", "ctr1")] == ["PFI12", "PFI13"]
    assert [find_default_terminal(s_series, item) for item in ("ctr0", "ctr1")] == ["Ctr0Out", "Ctr1Out"]


def test_a_counter_that_starts_nothing_leaves_a_rig_without_holdoff(monkeypatch, tmp_path):
    class Refusing:
        def __init__(self, parameters, position, timeout_s):
            self.parameters, self.position = parameters, position

        def record_quiet_input(self):
            return waveform_of(np.zeros(100), pretrigger_samples=0)

        def strike(self):
            raise ConfigurationError("its counter cannot start it")

        def close(self):
            pass

    monkeypatch.setattr("hardware_drivers.daqmx.pulse_record.FreeInput", Refusing)
    board = SimpleNamespace(ranges_v=((-5.0, 5.0), (-42.0, 42.0)), max_rate_hz=10e6)
    bench = Bench(boards={"00F12015": board}, data_folder=tmp_path)
    try:
        bench.wire("C", TransducerWiring(board_serial="00F12015", counter="ctr1", output_terminal="Ctr1Out"))
        assert bench.parameters().holdoff_s == 0.0106
        assert bench.parameters().transducers["C"].range_v == 5.0, "the largest up to 10 V"
        with pytest.raises(ConfigurationError, match="cannot start it"):
            bench.strike("C")
        assert (bench.strikes, bench.propose_values(), bench.parameters().holdoff_s) == (0, None, None)
    finally:
        bench.close()


@pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS or "there are")
def test_serial_instruments_are_identified_and_nothing_is_switched(tmp_path):
    with SerialInstruments(tmp_path) as there:
        ports = [str(link.path) for link in (there.supply_link, there.climate_link)]
        tables, off = ask_for_other_instruments(Dialogue(), {}, *ports, asks=False)
        assert {text for _, text in there.supply_link.heard()} == {"*IDN?"}
        assert there.list_output_changes() == []
    assert tables["supply"]["identity"] == r"SOLIMON,DC\ SUPPLY\ DOUBLE,SD0001"
    assert tables["climate"]["line"]["port"] == ports[1]
    assert off == {("rig", "niscope")}
    with pytest.raises(InstrumentError, match="no-such-port"):
        ask_for_other_instruments(Dialogue(), {}, "/dev/no-such-port", "", asks=False)


@probes.needs_niscope
def test_a_probe_s_board_is_known_by_its_serial_number():
    with probes.met_brain(probes.description()):
        tables, off = ask_for_other_instruments(Dialogue(), {"A": f"{probes.RESOURCE}/0"}, "", "", asks=False)
    assert tables["niscope"]["probes"]["A"]["serial_number"] == f"{probes.SERIAL:08X}"
    assert ("rig", "niscope") not in off
