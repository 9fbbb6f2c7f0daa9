"""Renders contract values as text for people."""

from __future__ import annotations

import json
from typing import Any


def told(value: Any) -> str:
    if isinstance(value, bytes):
        return f"0x{value.hex()}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{told(key)}: {told(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(told(item) for item in value) + "]"
    if isinstance(value, tuple):
        return "(" + ", ".join(told(item) for item in value) + ("," if len(value) == 1 else "") + ")"
    return repr(value)


def told_short(value: Any, limit_chars: int = 60) -> str:
    text = told(value)
    return text if len(text) <= limit_chars else text[: limit_chars - 3] + "..."
