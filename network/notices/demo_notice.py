"""The demonstration hospital's privacy notice, as shipped."""

from __future__ import annotations

from functools import cache
from importlib import resources

from consensus.bounded_text import read_toml_text
from consensus.rights.notices import Notice, notice_from

DEMO_ORGANISATION = "hospital"


def demo_notice_text() -> str:
    return resources.files("network.notices").joinpath("demo_notice.toml").read_text(encoding="utf-8")


@cache
def demo_notice() -> Notice:
    return notice_from(read_toml_text(demo_notice_text()))
