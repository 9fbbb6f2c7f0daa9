"""Gas and coverage over all chains of a test run."""

from __future__ import annotations

from statistics import median
from typing import Any

from contracts.kit.chain import Chain
from contracts.kit.recorder import LineFigures


class SourceFigures:
    """One source: file (empty if none), executable lines, gas per call."""

    def __init__(self, contract: str, file: str, source: str) -> None:
        self.contract = contract
        self.file = file
        self.source = source
        self.lines: dict[int, LineFigures] = {}
        self.gas: dict[str, list[int]] = {}

    @property
    def covered_count(self) -> int:
        return sum(1 for figures in self.lines.values() if figures.runs)

    def document(self) -> dict[str, Any]:
        return {
            "contract": self.contract,
            "file": self.file,
            "covered": self.covered_count,
            "lines_count": len(self.lines),
            "missing": [number for number, figures in sorted(self.lines.items()) if not figures.runs],
            "lines": [
                {"line": number, "runs": figures.runs, "gas": figures.gas}
                for number, figures in sorted(self.lines.items())
            ],
            "entries": [
                {
                    "name": name,
                    "calls": len(gas),
                    "gas_min": min(gas),
                    "gas_median": int(median(gas)),
                    "gas_max": max(gas),
                }
                for name, gas in sorted(self.gas.items())
            ],
        }


class Report:
    """All sources seen by a test run's chains."""

    def __init__(self) -> None:
        self._sources: dict[tuple[str, str, str], SourceFigures] = {}

    def add(self, chain: Chain) -> None:
        for deployment in chain.deployments:
            file = "" if deployment.path is None else str(deployment.path)
            key = (deployment.name, file, deployment.source)
            figures = self._sources.setdefault(key, SourceFigures(deployment.name, file, deployment.source))
            for number, line in deployment.lines.items():
                found = figures.lines.setdefault(number, LineFigures())
                found.runs += line.runs
                found.gas += line.gas
            for entry, gas in deployment.gas.items():
                figures.gas.setdefault(entry, []).extend(gas)

    def document(self) -> dict[str, Any]:
        return {"sources": [figures.document() for _, figures in sorted(self._sources.items(), key=lambda row: row[0])]}
