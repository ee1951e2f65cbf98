"""`solimon token`, and a service for other users that does not start without tokens and TLS."""

import json
import sys
from pathlib import Path

import pytest
from support.command_line import solimon_here

from daq_service.commands.audit import read_audit_log
from daq_service.web.auth.tokens import create_token

TLS = Path(__file__).parents[3] / "fixtures" / "tls"
TEXT_LENGTH = 43  # 256 bits as base64


@pytest.fixture
def token(tmp_path):
    """Run `solimon token` on a folder; return exit code, standard output and standard error."""

    def run(*arguments):
        done = solimon_here("token", *arguments, "--data-dir", str(tmp_path), env={})
        return done.returncode, done.stdout, done.stderr

    return run


def test_a_token_is_created_printed_once_listed_and_revoked(token, tmp_path):
    code, out, err = token("create", "ann", "--role", "operator", "--days", "2")
    text = out.strip()
    assert (code, len(text)) == (0, TEXT_LENGTH)
    assert "operator token of ann" in err
    assert text not in err
    code, listed, _ = token("list")
    assert (code, listed.split()[:3]) == (0, ["ann", "operator", "valid"])
    assert text not in listed
    assert token("revoke", "ann")[:2] == (0, "the token of ann is revoked\n")
    assert token("list")[1].split()[2] == "revoked"
    entries = [
        (deed.what, deed.source, deed.result, deed.arguments)
        for _, deed in read_audit_log(tmp_path, limit=9)[0]
    ]
    assert entries == [
        ("revoke_token", "terminal", "done", {"name": "ann"}),
        ("create_token", "terminal", "done", {"name": "ann", "role": "operator", "days": 2.0}),
    ]


def test_json_is_one_object_and_holds_no_hash(token, tmp_path):
    assert json.loads(token("list", "--json")[1]) == {"file": str(tmp_path / "tokens.json"), "tokens": []}
    created = json.loads(token("create", "ann", "--role", "admin", "--json")[1])
    text = created.pop("token")
    assert len(text) == TEXT_LENGTH
    (listed,) = json.loads(token("list", "--json")[1])["tokens"]
    assert listed == created
    assert (listed["name"], listed["role"], listed["state"], listed["expires_utc"]) == (
        "ann",
        "admin",
        "valid",
        None,
    )
    revoked = json.loads(token("revoke", "ann", "--json")[1])
    assert revoked == listed | {"state": "revoked", "revoked_utc": revoked["revoked_utc"]}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("create", "ann", "--role", "admin"),
            "ann has a token; revoke it first with `solimon token revoke ann`",
        ),
        (("create", "b/n", "--role", "admin"), "'b/n' is not a valid token name; use up to 40 letters"),
        (
            ("create", "ben", "--role", "boss"),
            "'boss' is not one of 'viewer', 'operator', 'engineer', 'admin'",
        ),
        (("create", "ben", "--role", "admin", "--days", "0"), "0.0 is not in the range x>0"),
        (("revoke", "ben"), "there is no token 'ben' to revoke; there are: ann"),
    ],
)
def test_an_impossible_command_is_rejected_and_changes_nothing(token, tmp_path, arguments, message):
    create_token(tmp_path / "tokens.json", "ann", "viewer")
    before = (tmp_path / "tokens.json").read_bytes()
    code, out, err = token(*arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert (tmp_path / "tokens.json").read_bytes() == before


@pytest.mark.parametrize("arguments", [("create", "ann", "--role", "admin"), ("list",), ("revoke", "ann")])
@pytest.mark.parametrize("damage", ["unreadable", "foreign"])
def test_an_unreadable_token_file_is_reported_and_left_unchanged(token, tmp_path, arguments, damage):
    path = tmp_path / "tokens.json"
    if damage == "unreadable":
        path.mkdir()
    else:
        path.write_text('{"tokens": 1}', encoding="utf-8")
    code, out, err = token(*arguments)
    assert (code, out) == (4, "")
    assert ("cannot be read" if damage == "unreadable" else "is not a file of access tokens") in err
    assert path.is_dir() if damage == "unreadable" else path.read_text(encoding="utf-8") == '{"tokens": 1}'


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such mode")
def test_a_change_makes_the_file_its_owner_s_alone(token, tmp_path):
    token("create", "ann", "--role", "admin")
    path = tmp_path / "tokens.json"
    path.chmod(0o666)
    token("revoke", "ann")
    assert path.stat().st_mode & 0o777 == 0o600


# Services for other hosts


@pytest.mark.parametrize("command", ["serve", "run"])
def test_a_service_for_other_hosts_needs_a_token(tmp_path, monkeypatch, command):
    def started(*arguments, **options):
        raise AssertionError("it was started without its locks")

    for started_by in ("daq_service.web.server.serve", "daq_service.cli.run.Supervisor"):
        monkeypatch.setattr(started_by, started)
    folder = tmp_path / "data"
    folder.mkdir()
    files = f"tls_certificate = '{TLS / 'certificate.pem'}'\ntls_key = '{TLS / 'key.pem'}'\n"
    config = tmp_path / "lab.toml"
    config.write_text(f'[web]\nhost = "0.0.0.0"\nhost_names = ["lab.example.org"]\n{files}', encoding="utf-8")
    done = solimon_here(command, str(config), "--data-dir", str(folder), env={})
    assert (done.returncode, done.stdout) == (2, "")
    for phrase in ("web.host is '0.0.0.0'", "no valid access token", "solimon token create NAME"):
        assert phrase in done.stderr
