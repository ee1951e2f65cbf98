"""`notify test`, and the messages of `check-config` and a start about receivers."""

import json

import pytest
from support.receivers import http_receiver

from daq_service.cli.inspection import print_configuration
from daq_service.cli.run import serve_alone
from daq_service.cli.set_up.notify import run_test
from daq_service.errors import EXIT_NOT_MET, EXIT_OK, UsageError

SECRET = "correct-horse-battery-staple"


@pytest.fixture
def receiver():
    with http_receiver() as running:
        yield running


@pytest.fixture
def config(tmp_path, receiver):
    path = tmp_path / "test.toml"
    path.write_text(
        f'[notifications.receivers.duty]\nurl = "{receiver.url}/T0K3N"\nsecret_file = "duty.secret"\n',
        encoding="utf-8",
    )
    (tmp_path / "duty.secret").write_text(f"{SECRET}\n", encoding="utf-8")
    return path


def test_a_test_message_is_sent_and_its_result_reported(config, receiver, capsys):
    assert run_test(config=config, receiver=None, as_json=False) == EXIT_OK
    assert capsys.readouterr().out == f"{'duty':<24} ok      taken (204)\n"
    assert receiver.next().message["kind"] == "test"
    receiver.answers.put((503, {}))
    assert run_test(config=config, receiver="duty", as_json=True) == EXIT_NOT_MET
    result = json.loads(capsys.readouterr().out)["receivers"]["duty"]
    assert result == {"ok": False, "result": "the receiver answers 503 Service Unavailable", "status": 503}


def test_an_unknown_receiver_is_rejected(config):
    with pytest.raises(UsageError, match="no receiver 'night' is configured; there are: duty"):
        run_test(config=config, receiver="night", as_json=False)
    with pytest.raises(UsageError, match="no receivers are configured; there are: none"):
        run_test(config=None, receiver=None, as_json=False)


def test_a_configuration_check_exposes_no_secrets(config, receiver, tmp_path, capsys):
    print_configuration(config=config, data_dir=tmp_path, schema=False, as_json=False)
    printed = capsys.readouterr()
    assert f"receiver   duty: webhook, {receiver.url.removesuffix('/hook')}\n" in printed.out
    assert "T0K3N" not in printed.out
    assert SECRET not in printed.out
    (tmp_path / "duty.secret").unlink()
    print_configuration(config=config, data_dir=tmp_path, schema=False, as_json=False)
    assert "duty.secret cannot be read" in capsys.readouterr().err
    (tmp_path / "data").mkdir()
    with pytest.raises(UsageError, match=r"duty\.secret cannot be read"):
        serve_alone(config=config, data_dir=tmp_path / "data", port=0, restart_reason="", supervised=False)
