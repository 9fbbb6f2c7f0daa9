"""A card as a file: to print, as a QR code, as letters; readable by its owner alone, and never over another file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clients.registrar.card_sheet import build_card, describe_card, qr_text
from clients.sdk.new_files import write_new_file
from clients.sdk.terminal.qr_codes import read_qr
from consensus.members.vouchers import Card, decode_card_code, encode_card_code, issue_card
from consensus.primitives.keys import PrivateKey
from tests.unit.clients.sdk.test_qr_codes import drawn, packed

UNTIL_MS = 1_801_432_800_000


@pytest.fixture
def card() -> Card:
    return issue_card(
        PrivateKey(bytes([7] * 32)),
        chain_id=bytes(32),
        handle=bytes(range(32)),
        card_secret=bytes([9] * 32),
        role="subject",
        not_after_ms=UNTIL_MS,
    )


def write(path: Path, code: str, organisation: str = "hospital") -> str:
    write_new_file(path, describe_card(path.suffix, code, role="subject", organisation=organisation, until_ms=UNTIL_MS))
    assert path.stat().st_mode & 0o777 == 0o600
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("suffix", [".html", ".svg"])
def test_the_printed_code_registers(tmp_path: Path, card: Card, suffix: str) -> None:
    code = encode_card_code(card)
    printed = write(tmp_path / f"card{suffix}", code)
    svg = re.search(r"<svg.*?</svg>", printed, re.DOTALL)
    assert svg is not None
    read = read_qr(packed(drawn(svg[0])))
    assert read == qr_text(code)
    assert decode_card_code(read) == card
    assert (code in printed) == (suffix == ".html")


def test_a_text_file_has_the_code_alone(tmp_path: Path, card: Card) -> None:
    code = encode_card_code(card)
    assert write(tmp_path / "card.txt", code) == f"{code}\n"


def test_a_card_asks_nobody_for_anything_and_is_in_both_languages(card: Card) -> None:
    page = build_card(encode_card_code(card), role="subject", organisation="<b>ward</b>", until_ms=UNTIL_MS)
    assert "<script" not in page
    assert "Role: subject." in page
    assert "Papel: utente." in page
    assert "<b>" not in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org/2000/svg", "")
    assert 'lang="en"><h1>Enrolment card' in page
    assert 'lang="pt"><h1>Cartão de inscrição' in page
