"""What the demonstration leaves: report.html (one file, pictures inside), events.jsonl, summary.json.

Must never show a handle, a key or a tag; people are patient A, patient B and the visitor.
"""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any

from network.demo.checks import CheckList
from network.demo.story import DemoState

PICTURES_A_PERSON_COUNT = 4

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1 { font-size: 1.6rem; } h2 { margin-top: 2.5rem; font-size: 1.2rem; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: .3rem .6rem; border-bottom: 1px solid #ddd; }
td, th { vertical-align: top; } .held { color: #0a6b2d; } .failed { color: #b00020; font-weight: bold; }
figure { display: inline-block; margin: .5rem; } figure img { width: 26rem; max-width: 100%; }
figcaption { font-size: .85rem; }
"""


def build_summary(checks: CheckList, state: DemoState, *, nodes: int, store: str, out: Path) -> dict[str, Any]:
    """Return the one object that `demo --json` prints."""
    recording = state.summary
    return {
        "ok": checks.ok,
        "checks": checks.as_json(),
        "frames": recording.get("frames", {}),
        "blocks": state.blocks,
        "transactions": state.transactions,
        "latency_ms": recording.get("latency_ms", {}),
        "leader_kill_gap_s": state.kill.gap_s if state.kill else None,
        "nodes": nodes,
        "store": store.split("://", maxsplit=1)[0],
        "out": str(out),
    }


def write_report(out: Path, summary: dict[str, Any], state: DemoState) -> None:
    """Write summary.json and report.html into `out`."""
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    (out / "report.html").write_text(_page(summary, state), encoding="utf-8")


def _page(summary: dict[str, Any], state: DemoState) -> str:
    verdict = "Every check held." if summary["ok"] else "Not every check held."
    return (
        "<!doctype html>\n<html lang=en><meta charset=utf-8><title>BlockRobot: what happened</title>"
        f"<style>{_STYLE}</style><h1>BlockRobot: what happened</h1><p>{verdict} Four nodes of two organisations ran on "
        "this machine; a robot recorded two patients and a visitor; the patients looked, checked and erased.</p>"
        f"<h2>Checks</h2>{_checks_table(summary['checks'])}"
        f"<h2>What the robot kept</h2>{_figures_table(summary)}"
        f"<h2>What each patient sees</h2><p>Only herself, on the recorded empty corridor.</p>{_pictures(state)}"
        f"<h2>Patient A's audit trail</h2>{_trail(state)}</html>\n"
    )


def _checks_table(checks: list[dict[str, Any]]) -> str:
    rows = []
    for check in checks:
        mark = "<td class=held>held</td>" if check["ok"] else "<td class=failed>FAILED</td>"
        rows.append(f"<tr>{mark}<td>{html.escape(check['name'])}</td><td>{html.escape(check['detail'])}</td></tr>")
    return f"<table><tr><th></th><th>Check</th><th>Seen</th></tr>{''.join(rows)}</table>"


def _figures_table(summary: dict[str, Any]) -> str:
    rows = [(f"frames {name}", value) for name, value in summary["frames"].items()]
    for name, values in summary["latency_ms"].items():
        rows.append((f"{name} (ms)", ", ".join(f"{key} {value}" for key, value in values.items())))
    rows += [
        ("blocks", summary["blocks"]),
        ("transactions", summary["transactions"]),
        ("without finality after the leader's death (s)", summary["leader_kill_gap_s"]),
    ]
    cells = "".join(f"<tr><td>{html.escape(str(a))}</td><td>{html.escape(str(b))}</td></tr>" for a, b in rows)
    return f"<table>{cells}</table>"


def _pictures(state: DemoState) -> str:
    figures = []
    for patient, pictures in state.pictures.items():
        step = max(1, len(pictures) // PICTURES_A_PERSON_COUNT)
        for picture in pictures[::step][:PICTURES_A_PERSON_COUNT]:
            data = base64.b64encode(picture.read_bytes()).decode()
            name = patient.replace("patient-a", "patient A").replace("patient-b", "patient B")
            label = html.escape(f"{name}, frame {int(picture.stem)}")
            figures.append(
                f"<figure><img alt='{label}' src='data:image/png;base64,{data}'><figcaption>{label}</figcaption></figure>"
            )
    return "".join(figures) or "<p>There are no pictures.</p>"


def _trail(state: DemoState) -> str:
    rows = []
    for entry in state.audit:
        subject = entry["record_id"][:12] or "the visit"
        rows.append(
            f"<tr><td>{entry['height']}</td><td>{html.escape(entry['kind'])}</td><td>{html.escape(subject)}</td></tr>"
        )
    return f"<table><tr><th>Block</th><th>What</th><th>Record</th></tr>{''.join(rows)}</table>"
