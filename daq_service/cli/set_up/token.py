"""``token create|list|revoke``: who may reach a service, and what for."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from daq_service.commands.audit import TERMINAL, Audit
from daq_service.commands.send import user_name
from daq_service.processes.data_folder import prepare_data_folder, settings_of_folder
from daq_service.web.auth.roles import CLAIMED, Role
from daq_service.web.auth.tokens import Token, create_token, read_tokens, revoke_token, tokens_file


def run_create(
    *, name: str, role: Role, days: float | None, config: Path | None, data_dir: Path | None, as_json: bool
) -> None:
    """Make a token and print it; what is printed is stored nowhere."""
    path, audit = _places(config, data_dir)
    token, text = create_token(path, name, role, days=days)
    _told(audit, "create_token", name=name, role=role, days=days)
    if as_json:
        click.echo(json.dumps(_shown(token) | {"token": text}))
        return
    click.echo(f"{role} token of {name}, in {path}, until {token.expires_utc or 'it is revoked'}:", err=True)
    click.echo(text)
    click.echo("It is shown this once. A running service lets it in within a second.", err=True)


def run_list(*, config: Path | None, data_dir: Path | None, as_json: bool) -> None:
    """Print all tokens, without what opens."""
    path, _ = _places(config, data_dir)
    tokens = [_shown(token) for token in read_tokens(path)]
    if as_json:
        click.echo(json.dumps({"file": str(path), "tokens": tokens}))
        return
    for row in tokens:
        until = row["revoked_utc"] or row["expires_utc"] or ""
        click.echo(f"{row['name']:<24} {row['role']:<9} {row['state']:<8} {until}".rstrip())
    if not tokens:
        click.echo(f"no tokens in {path}", err=True)


def run_revoke(*, name: str, config: Path | None, data_dir: Path | None, as_json: bool) -> None:
    """Let a token open nothing any more."""
    path, audit = _places(config, data_dir)
    token = revoke_token(path, name)
    _told(audit, "revoke_token", name=name)
    click.echo(json.dumps(_shown(token)) if as_json else f"the token of {name} opens nothing any more")


def _places(config: Path | None, data_dir: Path | None) -> tuple[Path, Audit]:
    settings, folder = settings_of_folder(config, data_dir)
    prepare_data_folder(folder)
    return tokens_file(settings.web, folder), Audit(folder)


def _told(audit: Audit, what: str, **arguments: Any) -> None:
    audit.add(who=user_name(), role=CLAIMED, source=TERMINAL, what=what, arguments=arguments, result="done")


def _shown(token: Token) -> dict[str, Any]:
    shown = asdict(token) | {"state": token.state}
    del shown["sha256"]
    return shown
