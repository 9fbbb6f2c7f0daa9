"""A browser is told of a file where there is one to tell."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import pytest

from pages.opening import open_in_browser


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.chdir(tmp_path)
    addresses: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: addresses.append(address) is None)
    return addresses


def test_a_file_in_a_folder_that_is_named_from_here_is_opened_by_its_whole_name(
    told: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    assert open_in_browser(Path("links/open.html"))
    assert told == [(tmp_path / "links" / "open.html").as_uri()]


def test_without_a_screen_no_browser_is_started_in_the_terminal_unless_one_was_named(
    told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not open_in_browser(Path("open.html"))
    assert told == []
    monkeypatch.setenv("BROWSER", "firefox")
    assert open_in_browser(Path("open.html"))
