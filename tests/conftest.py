"""Puts `tests/` on the import path, so that tests of every kind share `support`; guards every test."""

import pytest
from support.leaks import LeakGuard, mark_descendants

SLOW_TEST_S = 3600.0
"""The longest of the tests marked slow takes a third of it."""


def pytest_configure(config: pytest.Config) -> None:
    mark_descendants()
    config.pluginmanager.register(LeakGuard(), "leak-guard")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_TEST_S))
