"""``token create|list|revoke``: manage the access tokens of a service."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from daq_service.commands.audit import TERMINAL, Audit
from daq_service.commands.send import get_user_name
from daq_service.processes.data_folder import load_settings_for_reading, prepare_data_folder
from daq_service.web.auth.roles import CLAIMED, Role
from daq_service.web.auth.tokens import Token, create_token, find_tokens_file, read_tokens, revoke_token


def run_create(
    *, name: str, role: Role, days: float | None, config: Path | None, data_dir: Path | None, as_json: bool
) -> None:
    """Run `solimon token create`: create an access token and print it; only its hash is stored.

    Valid for ``days``; None: until revoked. Writes an audit entry.

    Raises
    ------
    UsageError
        The name or the configuration is refused.
    StorageError
        The folder cannot be written.
    """
    path, audit = _find_token_files(config, data_dir)
    token, text = create_token(path, name, role, days=days)
    _add_audit_entry(audit, "create_token", name=name, role=role, days=days)
    if as_json:
        click.echo(json.dumps(_describe_token(token) | {"token": text}))
        return
    click.echo(f"{role} token of {name}, in {path}, until {token.expires_utc or 'it is revoked'}:", err=True)
    click.echo(text)
    click.echo("It is shown this once. A running service lets it in within a second.", err=True)


def run_list(*, config: Path | None, data_dir: Path | None, as_json: bool) -> None:
    """Run `solimon token list`: print name, role, state and end of all access tokens, not their secrets.

    Raises UsageError for an invalid configuration, StorageError for an unusable folder.
    """
    path, _ = _find_token_files(config, data_dir)
    tokens = [_describe_token(token) for token in read_tokens(path)]
    if as_json:
        click.echo(json.dumps({"file": str(path), "tokens": tokens}))
        return
    for row in tokens:
        until = row["revoked_utc"] or row["expires_utc"] or ""
        click.echo(f"{row['name']:<24} {row['role']:<9} {row['state']:<8} {until}".rstrip())
    if not tokens:
        click.echo(f"no tokens in {path}", err=True)


def run_revoke(*, name: str, config: Path | None, data_dir: Path | None, as_json: bool) -> None:
    """Run `solimon token revoke`: revoke an access token and write an audit entry.

    Raises UsageError if there is no such token, StorageError if the folder or its file cannot be used.
    """
    path, audit = _find_token_files(config, data_dir)
    token = revoke_token(path, name)
    _add_audit_entry(audit, "revoke_token", name=name)
    click.echo(json.dumps(_describe_token(token)) if as_json else f"the token of {name} is revoked")


def _find_token_files(config: Path | None, data_dir: Path | None) -> tuple[Path, Audit]:
    """Return the path of the token file and the audit log of a test; create the data folder if missing.

    Raises UsageError for an invalid configuration, StorageError if the folder cannot be used.
    """
    settings, folder = load_settings_for_reading(config, data_dir)
    prepare_data_folder(folder)
    return find_tokens_file(settings.web, folder), Audit(folder)


def _add_audit_entry(audit: Audit, action: str, **arguments: object) -> None:
    """Append an action on tokens, with the present user as its author, to the audit log.

    An OSError is logged, not raised.
    """
    audit.add(
        author=get_user_name(), role=CLAIMED, source=TERMINAL, what=action, arguments=arguments, result="done"
    )


def _describe_token(token: Token) -> dict[str, object]:
    """Convert a token to a JSON object with its state, without the hash of its secret."""
    shown = asdict(token) | {"state": token.state}
    del shown["sha256"]
    return shown
