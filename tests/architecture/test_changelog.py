"""CHANGELOG.md has the form of Keep a Changelog: versions, and in each the kinds of changes in order."""

import re
from pathlib import Path

TEXT = (Path(__file__).parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
KINDS = ["Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"]


def test_each_version_lists_kinds_of_changes_in_order():
    assert TEXT.startswith("# Changelog\n")
    versions = re.split(r"(?m)^## ", TEXT)[1:]
    assert versions[0].startswith("[Unreleased]\n")
    for version in versions:
        heading, *sections = re.split(r"(?m)^### ", version)
        assert re.fullmatch(r"\[(Unreleased|\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d)\]?\s*", heading), heading
        kinds = [section.split("\n", 1)[0] for section in sections]
        assert kinds == [kind for kind in KINDS if kind in kinds], heading
        assert all(re.match(r"\w+\n\n- ", section) for section in sections), heading
