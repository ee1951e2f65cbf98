"""Building the C library: once and completely, also in parallel; a clear remedy on failure."""

import os
import subprocess
import sys

import pytest
from support.doubles_bench import one_board_description

from simulator.doubles.chassis.description import build_default_description, from_json, to_json
from simulator.doubles.errors import LibraryBuildError
from simulator.doubles.transports import library
from simulator.doubles.transports.c_source import generate_library_source
from simulator.doubles.transports.library import build_environment, build_library, find_unavailability_reason

needs_compiler = pytest.mark.skipif(
    bool(find_unavailability_reason()), reason=find_unavailability_reason() or "never"
)


@needs_compiler
def test_the_library_is_built_once(tmp_path, monkeypatch):
    folder = build_library("nidaqmx", tmp_path)
    monkeypatch.setattr(library, "_compile_library", lambda *_: pytest.fail("built again"))
    assert build_library("nidaqmx", tmp_path) == folder
    assert [child.name for child in tmp_path.iterdir()] == [folder.name]


@needs_compiler
def test_another_source_is_another_library(tmp_path, monkeypatch):
    first = build_library("nidaqmx", tmp_path)
    monkeypatch.setattr(library, "generate_library_source", lambda name: generate_library_source(name) + "\n")
    assert build_library("nidaqmx", tmp_path) != first


@needs_compiler
def test_a_process_that_is_first_wins_and_the_other_takes_its_folder(tmp_path, monkeypatch):
    compile_really = library._compile_library

    def overtaken(source, flags, target):
        compile_really(source, flags, target)
        monkeypatch.setattr(library, "_compile_library", compile_really)
        build_library("nidaqmx", tmp_path)

    monkeypatch.setattr(library, "_compile_library", overtaken)
    folder = build_library("nidaqmx", tmp_path)
    assert [child.name for child in tmp_path.iterdir()] == [folder.name]


@needs_compiler
def test_the_source_compiles_without_a_warning(tmp_path):
    written = tmp_path / "double.c"
    for name in ("nidaqmx", "niScope"):
        written.write_text(generate_library_source(name), encoding="utf-8")
        checked = subprocess.run(
            # A reserved pointer is an unused parameter; attributes are NI-DAQmx's only.
            [
                "cc",
                "-std=gnu11",
                "-Wall",
                "-Wextra",
                "-Werror",
                "-Wno-unused-parameter",
                "-Wno-unused-function",
                "-fsyntax-only",
                str(written),
            ],
            capture_output=True,
            text=True,
            check=False,
        )
        assert checked.returncode == 0, checked.stderr


@needs_compiler
def test_a_compiler_that_refuses_is_quoted(tmp_path, monkeypatch):
    monkeypatch.setattr(library, "generate_library_source", lambda name: "this is not C;")
    with pytest.raises(LibraryBuildError, match="error"):
        build_library("nidaqmx", tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the remedy differs")
@pytest.mark.parametrize(
    ("tools", "remedy"),
    [((), "install one"), (("cc",), "install binutils"), (("cc", "ld"), "objdump not on")],
)
def test_missing_tools_are_named_with_the_remedy(tmp_path, monkeypatch, tools, remedy):
    for tool in tools:
        (tmp_path / tool).symlink_to(sys.executable)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert remedy in find_unavailability_reason()
    with pytest.raises(LibraryBuildError, match=remedy):
        build_library("nidaqmx", tmp_path / "cache")


def test_other_systems_than_linux_are_reported(monkeypatch, tmp_path):
    monkeypatch.setattr(library.sys, "platform", "win32")
    with pytest.raises(LibraryBuildError, match="Linux only"):
        build_library("nidaqmx", tmp_path)


def test_the_environment_puts_the_folders_first_and_keeps_what_was_there(tmp_path):
    found = build_environment("127.0.0.1:9", tmp_path, environment={"LD_LIBRARY_PATH": "/opt/x", "A": "b"})
    assert found == {
        "A": "b",
        "SOLIMON_DOUBLES": "127.0.0.1:9",
        "LD_LIBRARY_PATH": f"{tmp_path}{os.pathsep}/opt/x",
    }
    assert build_environment("h:1", tmp_path, environment={})["LD_LIBRARY_PATH"] == str(tmp_path)


# The description travels to the process as JSON


@pytest.mark.parametrize("make", [build_default_description, one_board_description])
def test_a_description_survives_json(make):
    assert to_json(from_json(to_json(make()))) == to_json(make())


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('"PXIe-6386"', '"PXIe-9999"', "known are"),
        ('"ai_channel": 1', '"ai_channel": 8', "has 8 inputs"),
        ('"counter": 1', '"counter": 4', "has 4 counters"),
        ('"ai_channel": 1', '"ai_channel": 0', "shares an input"),
        ('"counter_serial": 31547526', '"counter_serial": 5', "not described"),
        ('"lift_s": 0.005', '"lift_s": 5.0', "less than or equal to 1"),
        ('"boards"', '"planks"', "planks"),
    ],
)
def test_an_impossible_description_is_refused_with_its_reason(old, new, reason):
    text = to_json(one_board_description())
    assert old in text
    with pytest.raises(ValueError, match=reason):
        from_json(text.replace(old, new))
