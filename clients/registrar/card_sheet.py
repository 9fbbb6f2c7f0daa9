"""A printable enrolment card with QR code and letters."""

from __future__ import annotations

import html

from clients.sdk.terminal.qr_codes import qr_svg
from consensus.members.vouchers import CODE_PREFIX
from pages.time_format import format_time

SUFFIXES = (".html", ".svg", ".txt")
_STYLE = """\
@page { margin: 12mm; }
body { color: #000; background: #fff; font: 10pt/1.35 sans-serif; margin: 0; }
.card { border: 1px solid #000; border-radius: 3mm; display: flex; gap: 5mm; max-width: 170mm; padding: 5mm; }
.card svg { flex: none; height: 52mm; width: 52mm; }
h1 { font-size: 13pt; margin: 0 0 2mm; }
p { margin: 0 0 2mm; }
code { font: 8pt/1.4 monospace; overflow-wrap: anywhere; }
"""
_WORDS = {
    "en": (
        "Enrolment card",
        "Role: {role}. Issued by {organisation}. Works once, until {until}.",
        "Scan it in your wallet's page, or photograph it: blockrobot wallet register @PICTURE. Until you have registered, "
        "whoever has this code can register in your place: give it to nobody, and destroy it afterwards.",
    ),
    "pt": (
        "Cartão de inscrição",
        "Papel: {role}. Emitido por {organisation}. Serve uma vez, até {until}.",
        "Leia-o na página da sua carteira, ou fotografe-o: blockrobot wallet register @IMAGEM. Até fazer a inscrição, quem "
        "tiver este código pode inscrever-se em seu lugar: não o dê a ninguém, e destrua-o depois.",
    ),
}
_ROLES = {"pt": {"subject": "utente", "staff": "membro do pessoal", "robot": "robô", "officer": "encarregado"}}
"""Roles in words, as the wallet says them."""


def qr_text(code: str) -> str:
    return CODE_PREFIX + code.removeprefix(CODE_PREFIX).replace("-", "")


def build_card(code: str, *, role: str, organisation: str, until_ms: int) -> str:
    told = {"organisation": organisation, "until": format_time(until_ms)}
    lines = {
        language: html.escape(line.format(role=_ROLES.get(language, {}).get(role, role), **told))
        for language, (_, line, _) in _WORDS.items()
    }
    words = "".join(
        f'<section lang="{language}"><h1>{title}</h1><p>{lines[language]}</p><p>{advice}</p></section>'
        for language, (title, _, advice) in _WORDS.items()
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Enrolment card</title>'
        '<meta name="robots" content="noindex"><meta http-equiv="Content-Security-Policy" '
        "content=\"default-src 'none'; style-src 'unsafe-inline'\">"
        f'<style>{_STYLE}</style></head><body><div class="card">{qr_svg(qr_text(code))}<div>{words}'
        f"<p><code>{html.escape(code)}</code></p></div></div></body></html>\n"
    )


def describe_card(suffix: str, code: str, *, role: str, organisation: str, until_ms: int) -> str:
    if suffix == ".html":
        return build_card(code, role=role, organisation=organisation, until_ms=until_ms)
    return qr_svg(qr_text(code)) if suffix == ".svg" else f"{code}\n"
