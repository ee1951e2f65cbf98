"""Limits of classes, functions and parameters, and the exceptions with a reason for each."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("daq_service", "hardware_drivers", "analysis", "simulator")
MOST_LINES_OF_A_CLASS, MOST_LINES_OF_A_FUNCTION, MOST_PARAMETERS = 300, 80, 8

OPTIONS = "one parameter for each option of the command line, as click passes them"
QUERY = "one parameter for each query parameter of the route, as FastAPI reads them"
EXCEPTIONS = {
    (
        "daq_service/archive/journal/frames.py",
        "_build_frame",
        "parameters",
    ): "one for each field of the format",
    ("daq_service/cli/demo.py", "run_demo", "parameters"): OPTIONS,
    ("daq_service/cli/offline/assess.py", "run_assess", "parameters"): OPTIONS,
    ("daq_service/cli/offline/design/command.py", "run_design", "parameters"): OPTIONS,
    ("daq_service/cli/offline/features.py", "run_features", "parameters"): OPTIONS,
    ("daq_service/cli/set_up/setup.py", "run_setup", "parameters"): OPTIONS,
    ("daq_service/cli/simulate.py", "print_simulation", "parameters"): OPTIONS,
    ("daq_service/commands/send.py", "send_command", "parameters"): "two times and the clock for tests",
    (
        "daq_service/corrosion_drive/drive.py",
        "SupplyLogger",
        "class",
    ): "each reading and command changes one state",
    (
        "daq_service/corrosion_drive/remote.py",
        "RemoteDrive",
        "class",
    ): "one connection and the requests on it",
    (
        "daq_service/processes/supervisor.py",
        "Supervisor.__init__",
        "parameters",
    ): "tests replace processes and times",
    ("daq_service/web/routes/tables.py", "get_table", "parameters"): QUERY,
    ("daq_service/web/routes/waterfall.py", "get_waterfall", "function"): "half of it describes parameters",
    ("daq_service/web/routes/waterfall.py", "get_waterfall", "parameters"): QUERY,
    ("daq_service/web/routes/waveforms.py", "get_waveform", "function"): "half of it describes parameters",
    ("hardware_drivers/serial_port/line.py", "SerialLine", "class"): "one port and one recovery",
    ("analysis/statistics/bins.py", "make_bins", "parameters"): "one array for each column",
    ("simulator/electronics/transduction.py", "simulate_triggered_record", "parameters"): "numerical kernel",
    ("simulator/shot/kernel.py", "_advance_mode", "parameters"): "numerical kernel",
    ("simulator/shot/kernel.py", "_make_time_loop", "function"): "numerical kernel",
    ("simulator/shot/kernel.py", "_make_time_loop.integrate", "function"): "numerical kernel",
    ("simulator/zener/model.py", "inelasticity_parameter", "parameters"): "numerical kernel",
}


def too_long(node, outer=""):
    """Yield qualified name and kind of each limit that a definition in a module exceeds."""
    for inner in ast.iter_child_nodes(node):
        name = outer
        if isinstance(inner, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            name = f"{outer}.{inner.name}".lstrip(".")
            first = min([inner.lineno, *(decorator.lineno for decorator in inner.decorator_list)])
            lines = (inner.end_lineno or inner.lineno) - first + 1
            if isinstance(inner, ast.ClassDef):
                if lines > MOST_LINES_OF_A_CLASS:
                    yield name, "class"
            else:
                if lines > MOST_LINES_OF_A_FUNCTION:
                    yield name, "function"
                named = [*inner.args.posonlyargs, *inner.args.args, *inner.args.kwonlyargs]
                if len([item for item in named if item.arg not in ("self", "cls")]) > MOST_PARAMETERS:
                    yield name, "parameters"
        yield from too_long(inner, name)


def test_classes_functions_and_parameters_stay_within_their_limits():
    found = {
        (path.relative_to(ROOT).as_posix(), name, kind)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for name, kind in too_long(ast.parse(path.read_text(encoding="utf-8")))
    }
    assert sorted(found - EXCEPTIONS.keys()) == [], "split it, or give a reason"
    assert sorted(EXCEPTIONS.keys() - found) == [], "no longer an exception"


def test_the_main_module_of_the_recording_line_names_its_stages_in_order():
    text = (ROOT / "daq_service/recording/recorder.py").read_text(encoding="utf-8")
    classes = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.ClassDef)}
    names = [node.name for node in classes["Recorder"].body if isinstance(node, ast.FunctionDef)]
    stages = ["plan", "acquire", "persist", "extract", "assess", "commit", "publish"]
    assert [name for name in names if name in stages] == stages
    assert len(text.splitlines()) <= 250
