import pytest


@pytest.fixture(scope="session")
def reduction_folder(tmp_path_factory):
    """One folder for the session: a plate is reduced once, the user's cache stays untouched."""
    return tmp_path_factory.mktemp("reductions")
