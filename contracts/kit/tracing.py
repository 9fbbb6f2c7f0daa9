"""A traced call as text and JSON: lines, costs, values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from consensus.visible_text import split_lines
from contracts.kit.recorder import Step

SOURCE_SHOWN_CHARS = 66


@dataclass(frozen=True, slots=True)
class Trace:
    """A call's result and steps; `sources` are texts by contract."""

    title: str
    code: str
    message: str
    line: int | None
    gas_used: int
    steps: Sequence[Step]
    left_out_count: int
    sources: Mapping[str, str]

    def source_line(self, contract: str, number: int) -> str:
        lines = split_lines(self.sources.get(contract, ""))
        return lines[number - 1].rstrip() if 0 < number <= len(lines) else ""

    def text(self) -> str:
        rows = [f"{self.title}: {self.code}, {self.gas_used} gas"]
        place = ("", "")
        for step in self.steps:
            if (step.contract, step.function) != place:
                place = (step.contract, step.function)
                rows.append(f"  {step.contract}.{step.function}")
            source = self.source_line(step.contract, step.line)
            shown = source if len(source) <= SOURCE_SHOWN_CHARS else source[: SOURCE_SHOWN_CHARS - 3] + "..."
            values = ", ".join(f"{name} = {value}" for name, value in step.values.items())
            rows.append(f"  {step.line:>5} {step.gas:>7}  {shown:<{SOURCE_SHOWN_CHARS}}  {values}".rstrip())
        if self.left_out_count:
            rows.append(f"  ... {self.left_out_count} more statements")
        if self.code != "OK":
            where = f" at line {self.line}" if self.line is not None else ""
            rows.append(f"  failed{where}: {self.code}{': ' if self.message else ''}{self.message}")
        return "\n".join(rows)

    def document(self) -> dict[str, Any]:
        return {
            "call": self.title,
            "code": self.code,
            "message": self.message,
            "line": self.line,
            "gas_used": self.gas_used,
            "steps": [
                {
                    "contract": step.contract,
                    "function": step.function,
                    "line": step.line,
                    "depth": step.depth,
                    "gas": step.gas,
                    "source": self.source_line(step.contract, step.line).strip(),
                    "values": step.values,
                }
                for step in self.steps
            ],
            "left_out": self.left_out_count,
        }
