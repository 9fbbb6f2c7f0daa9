"""What others wrote is parsed within bounds by one module, and files that a user names are written by one module."""

from __future__ import annotations

import re

from tests.architecture.test_tidy import ROOT, matches, modules

BOUNDED_TEXT = ROOT / "consensus" / "bounded_text.py"
PARSES = re.compile(r"\bjson\.loads?\b|\btomllib\.|\bmsgspec\.(?:json\.(?:decode|Decoder)|toml|yaml)\b|\byaml\.\w*load")
PARSES_BESIDE = {
    "clients/wallet/present/translations.py": "the wallet's own catalogue, which every start reads",
    "clients/robot/sources/messages/field_map.py": "a field of bounded length; half characters are refused as well",
}


def test_texts_of_others_are_parsed_by_one_module() -> None:
    """Elsewhere a text of brackets would end a command with a traceback."""
    others = [path for path in modules() if path != BOUNDED_TEXT]
    assert {found.split(":")[0] for found in matches(others, PARSES)} == set(PARSES_BESIDE)
