"""A web service of the folder `filled` that a module defines, and its client."""

import pytest
from support.served_web import served


@pytest.fixture(scope="module")
def service(filled):
    with served(filled.settings, filled.folder) as running:
        yield running


@pytest.fixture(scope="module")
def api(service):
    with service.client() as client:
        yield client
