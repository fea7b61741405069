#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox[uv]>=2025.10.14"]
# ///
"""Checks in an environment of their own: `uv run noxfile.py -s lint`, `uv run noxfile.py -s lowest`."""

import nox

nox.needs_version = ">=2025.10.14"
nox.options.default_venv_backend = "uv"


@nox.session
def lint(session: nox.Session) -> None:
    """Run all hooks of pre-commit: lint, format, types, spelling, workflows."""
    session.install(".", "--group=dev")
    session.run("pre-commit", "run", "--all-files", *session.posargs)


@nox.session(python="3.11")
def lowest(session: nox.Session) -> None:
    """Run `isacbench run` and the tests with the lowest versions of pyproject.toml, on the oldest Python."""
    session.install("--resolution=lowest-direct", ".[test]")
    session.run("isacbench", "run", f"--out={session.create_tmp()}/run")
    session.run("pytest", *session.posargs)


if __name__ == "__main__":
    nox.main()
