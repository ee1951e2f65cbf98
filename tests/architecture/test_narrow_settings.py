"""A component receives the settings that it uses; only composition roots take the whole `Settings`."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "daq_service"
ROOTS = (
    "cli",
    "rig",
    "settings",
    "web/app.py",
    "web/context.py",
    "web/multi_test/app.py",
    "recording/session.py",
)
"""Files and folders that start or compose a test, or are about the settings themselves."""
LARGEST_NUMBER = 32
"""Functions that still take all settings; lower it with the code."""


def takes_settings(function):
    """Return whether a parameter of a function is annotated with `Settings`."""
    parameters = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    names = (
        name for parameter in parameters if parameter.annotation for name in ast.walk(parameter.annotation)
    )
    return any(isinstance(name, ast.Name) and name.id == "Settings" for name in names)


def functions_with_settings(source):
    """Return the names of the functions that take all settings."""
    functions = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef))
    return [function.name for function in functions if takes_settings(function)]


def test_few_functions_outside_composition_roots_take_all_settings():
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if not name.startswith(ROOTS):
            found += [f"{name}: {function}" for function in functions_with_settings(path.read_text("utf-8"))]
    assert len(found) <= LARGEST_NUMBER, "give them the section they use:\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("parameters", "is_found"),
    [
        ("settings: Settings", True),
        ("*, settings: Settings | None = None", True),
        ("settings: AlarmSettings", False),
        ("settings", False),
    ],
)
def test_a_function_is_found_by_the_type_of_its_parameters(parameters, is_found):
    assert functions_with_settings(f"class A:\n    def f(self, {parameters}): ...") == ["f"] * is_found
