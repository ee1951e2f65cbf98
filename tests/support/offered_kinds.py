"""Distributions that are not installed: a folder on the path whose metadata offers kinds of instruments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from hardware_drivers.kinds import GROUPS, Role


def offer(
    patch: pytest.MonkeyPatch,
    folder: Path,
    offered: Mapping[str, Mapping[Role, str]],
    *,
    distribution: str = "lab-drivers",
) -> None:
    """Let a distribution offer kinds by name and role (`module:object`), until the patch is undone."""
    metadata = folder / f"{distribution.replace('-', '_')}-1.2.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.2\n", encoding="utf-8"
    )
    lines = []
    for role, group in GROUPS.items():
        lines.append(f"[{group}]")
        lines += [f"{name} = {roles[role]}" for name, roles in offered.items() if role in roles]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    patch.syspath_prepend(str(folder))
