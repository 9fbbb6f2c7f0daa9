"""Prints pyproject.toml requirements, one per line: `build` backend's, or an extra's."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def main() -> None:
    project = tomllib.loads(Path(__file__).resolve().parents[1].joinpath("pyproject.toml").read_text(encoding="utf-8"))
    lists = {"build": project["build-system"]["requires"], **project["project"]["optional-dependencies"]}
    sys.stdout.write("\n".join(lists[sys.argv[1]]) + "\n")


if __name__ == "__main__":
    main()
