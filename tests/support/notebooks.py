"""Notebooks carried out cell by cell as Jupyter does, without its kernel; the committed outputs are these.

Renew those of the example after a wanted change, in this folder's parent::

    python -m support.notebooks
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import tempfile
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from support.small_experiment import run, small_settings

EXAMPLE = Path(__file__).parents[2] / "examples" / "notebook" / "look_at_a_test.ipynb"
FOLDER = "my-test-data"
DPI = 50
"""A picture of some 10 kB."""


def example_settings() -> Any:
    """Return settings of the test that the example shows."""
    # The smallest baseline that gives a limit, and two sets behind it.
    return small_settings(schedule={"end_h": 8.5}, baseline={"hours": 7.5})


def executed(notebook: Mapping[str, Any], names: dict[str, Any]) -> dict[str, Any]:
    """Execute every cell in ``names`` and return the notebook with its outputs."""
    import matplotlib as mpl

    mpl.use("agg")
    done = deepcopy(dict(notebook))
    number = 0
    for cell in done["cells"]:
        if cell["cell_type"] == "code":
            number += 1
            cell["execution_count"] = number
            cell["outputs"] = _outputs("".join(cell["source"]), names, number)
    return done


def _outputs(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    import matplotlib.pyplot as plt

    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(tree, "cell", "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    outputs: list[dict[str, Any]] = []
    if output.getvalue():
        lines = output.getvalue().splitlines(keepends=True)
        outputs.append({"output_type": "stream", "name": "stdout", "text": lines})
    if value is not None and not source.rstrip().endswith(";"):
        data = {"text/plain": repr(value).splitlines(keepends=True)}
        outputs.append(
            {"output_type": "execute_result", "data": data, "metadata": {}, "execution_count": number}
        )
    for figure in map(plt.figure, plt.get_fignums()):
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=DPI, metadata={"Software": None})
        encoded = base64.b64encode(picture.getvalue()).decode() + "\n"
        data = {"image/png": [encoded], "text/plain": [f"<Figure with {len(figure.axes)} Axes>"]}
        outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
    plt.close("all")
    return outputs


def read(path: Path = EXAMPLE) -> dict[str, Any]:
    """Read a notebook."""
    notebook: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return notebook


def main() -> None:
    """Write the outputs of the example again."""
    with tempfile.TemporaryDirectory() as place:
        assert run(example_settings(), Path(place) / FOLDER)
        os.chdir(place)
        done = executed(read(), {})
        os.chdir(EXAMPLE.parent)
    EXAMPLE.write_text(json.dumps(done, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
