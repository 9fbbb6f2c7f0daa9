"""Prints what pyproject.toml asks for, one requirement a line: of the build backend (`build`), or of the extra named."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def main() -> None:
    """Print the list whose name is the only argument."""
    project = tomllib.loads(Path(__file__).resolve().parents[1].joinpath("pyproject.toml").read_text(encoding="utf-8"))
    lists = {"build": project["build-system"]["requires"], **project["project"]["optional-dependencies"]}
    sys.stdout.write("\n".join(lists[sys.argv[1]]) + "\n")


if __name__ == "__main__":
    main()
