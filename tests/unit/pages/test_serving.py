"""What a browser is given of a page: its files, under headers that let nothing else run."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from pages.serving import ASSET_MAX_BYTES, PAGES_ASSETS, Assets


def test_a_file_is_given_with_its_type_and_strict_headers() -> None:
    response = Assets(PAGES_ASSETS).response("dom.js")
    assert response.headers["Content-Type"].startswith("text/javascript")
    policy = response.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert response.headers["X-Content-Type-Options"] == "nosniff"


def test_a_browser_that_has_the_file_gets_no_second_copy() -> None:
    assets = Assets(PAGES_ASSETS)
    etag = assets.response("design.css").headers["ETag"]
    again = assets.response("design.css", {"If-None-Match": f'"other", {etag}'})
    assert again.status == 304
    assert again.body is None
    assert assets.response("design.css", {"If-None-Match": '"other"'}).status == 200


@pytest.mark.parametrize("wanted", ["gzip", "br, GZIP;q=0.5", "deflate, gzip , br"])
def test_a_browser_that_takes_it_packed_gets_the_same_file_packed(wanted: str) -> None:
    assets = Assets(PAGES_ASSETS)
    packed, plain = assets.response("design.css", {"Accept-Encoding": wanted}), assets.response("design.css")
    assert isinstance(packed.body, bytes)
    assert (packed.headers["Content-Encoding"], packed.headers["Vary"]) == ("gzip", "Accept-Encoding")
    assert gzip.decompress(packed.body) == plain.body
    assert packed.headers["ETag"] != plain.headers["ETag"], "they are two representations"
    assert "Content-Encoding" not in plain.headers


@pytest.mark.parametrize("wanted", ["", "identity", "br", "gzip;q=0", "gzip; q=0.0", "xgzip"])
def test_a_browser_that_does_not_take_it_packed_gets_it_plain(wanted: str) -> None:
    assert "Content-Encoding" not in Assets(PAGES_ASSETS).response("design.css", {"Accept-Encoding": wanted}).headers


@pytest.mark.parametrize("name", ["../serving.py", "/etc/passwd", "", ".", "nothing.css", "dom.js/"])
def test_what_is_no_file_of_the_page_is_unknown(name: str) -> None:
    with pytest.raises(BlockRobotError) as refused:
        Assets(PAGES_ASSETS).response(name)
    assert refused.value.code == "ROUTE_UNKNOWN"


def test_a_page_is_what_was_read_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "a.css").write_text("p { margin: 0 }")
    (tmp_path / "notes.txt").write_text("not for browsers")
    assets = Assets(tmp_path)
    (tmp_path / "a.css").write_text("changed")
    assert assets.get("a.css").content == b"p { margin: 0 }"
    assert assets.names() == ["a.css"]


def test_of_two_folders_the_first_wins(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "page.js").write_text(folder)
    assert Assets(tmp_path / "one", tmp_path / "two").get("page.js").content == b"one"


def test_a_file_too_large_for_a_page_is_a_mistake_of_the_program(tmp_path: Path) -> None:
    (tmp_path / "big.png").write_bytes(bytes(ASSET_MAX_BYTES + 1))
    with pytest.raises(ValueError, match=r"big\.png"):
        Assets(tmp_path)


def test_no_shared_module_parses_text_as_html_or_runs_text() -> None:
    for name in Assets(PAGES_ASSETS).names():
        text = (PAGES_ASSETS / name).read_text(encoding="utf-8")
        for word in (
            "innerHTML",
            "outerHTML",
            "insertAdjacentHTML",
            "document.write",
            "eval(",
            "new Function",
            "http:",
        ):
            assert word not in text.replace("http://www.w3.org/2000/svg", ""), f"{name}: {word}"
