"""Renders contract values as text for people."""

from __future__ import annotations

import json
from typing import Any


def format_value(value: Any) -> str:
    if isinstance(value, bytes):
        return f"0x{value.hex()}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{format_value(key)}: {format_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(format_value(item) for item in value) + "]"
    if isinstance(value, tuple):
        return "(" + ", ".join(format_value(item) for item in value) + ("," if len(value) == 1 else "") + ")"
    return repr(value)


def format_short(value: Any, limit_chars: int = 60) -> str:
    text = format_value(value)
    return text if len(text) <= limit_chars else text[: limit_chars - 3] + "..."
