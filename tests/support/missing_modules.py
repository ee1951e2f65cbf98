"""Processes in which modules cannot be imported, as if their extra were not installed."""

from __future__ import annotations

import os
from pathlib import Path

BLOCKER = """
import sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {modules!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Missing())
"""


def environment_without(folder: Path, *modules: str) -> dict[str, str]:
    """Return the environment of a process, and of its children, that finds none of the modules.

    Python imports the file ``sitecustomize.py``, written to ``folder``, when it starts.
    """
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(BLOCKER.format(modules=modules), encoding="utf-8")
    paths = filter(None, (str(folder), os.environ.get("PYTHONPATH")))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
