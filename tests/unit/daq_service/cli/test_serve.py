"""`solimon serve PATH...`: paths of one test, of several tests, and their authentication."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from daq_service.cli import serve
from daq_service.cli.main import cli
from daq_service.errors import UsageError
from daq_service.web.context import find_app_context


@pytest.fixture
def served(monkeypatch, tmp_path):
    """Return the list of applications and settings that would be served; no port is opened."""
    found = []

    def serve_app(app, web, port):
        found.append((app, web, port))
        return 0

    def serve_alone(**options):
        found.append(options)
        return 0

    monkeypatch.setattr(serve, "serve_app", serve_app)
    monkeypatch.setattr(serve, "serve_alone", serve_alone)
    monkeypatch.setattr(serve, "log_to_file", lambda path: None)  # for the life of a process
    monkeypatch.chdir(tmp_path)
    return found


def run(*arguments):
    result = CliRunner().invoke(cli, ["serve", *map(str, arguments)])
    if isinstance(result.exception, UsageError):
        raise result.exception
    assert result.exit_code == 0, result.output


def test_one_path_serves_one_test_from_a_configuration_or_a_folder(served, tmp_path):
    (tmp_path / "folder").mkdir()
    run("test.toml", "--port", 0)
    run("folder")
    run("--data-dir", "folder")
    run()
    assert [(options["config"], options["data_dir"]) for options in served] == [
        (Path("test.toml"), None),
        (None, Path("folder")),
        (None, Path("folder")),
        (None, None),
    ]
    assert served[0]["port"] == 0


def test_two_names_of_a_folder_for_one_test_are_refused(served, tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(UsageError, match="both folder and --data-dir other name a data folder"):
        run("folder", "--data-dir", "other")
    with pytest.raises(UsageError, match="--web is for several tests"):
        run("folder", "--web", "service.toml")
    assert served == []


def test_several_paths_are_a_list_with_a_folder_of_the_service_s_own(served, tmp_path):
    run("a.toml", "b", "--port", 8123)
    app, web, port = served.pop()
    assert list(app.state.tests.all) == ["a", "b"]
    assert (web.host, port) == ("127.0.0.1", 8123)
    assert find_app_context(app).data_folder == tmp_path / "solimon-service"
    run("a.toml", "b", "--data-dir", tmp_path / "own")
    assert find_app_context(served.pop()[0]).data_folder == tmp_path / "own"
    assert not (tmp_path / "b").exists(), "no test's folder is made"


def test_address_and_tokens_of_several_are_those_of_the_configuration_named_for_them(served, tmp_path):
    file = tmp_path / "service" / "service.toml"
    file.parent.mkdir()
    file.write_text('[web]\nport = 9000\ntokens_file = "who.json"\n[storage]\nfolder = "own"')
    run("a.toml", "b", "--web", file)
    app, web, port = served.pop()
    assert (web.port, port) == (9000, None)
    assert find_app_context(app).data_folder == file.parent / "own"
    assert find_app_context(app).access_policy.tokens_path == file.parent / "who.json"


def test_a_service_of_several_that_others_reach_needs_a_token_of_its_own(served, tmp_path):
    file = tmp_path / "service.toml"
    file.write_text('[web]\nproxy = "127.0.0.1"\nhost_names = ["lab.example.org"]')
    with pytest.raises(UsageError, match="holds no valid access token"):
        run("a.toml", "b", "--web", file)
