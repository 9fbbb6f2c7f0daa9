"""Graphviz itself draws the map where it is installed; where it is not, the refusal says how to get it."""

from __future__ import annotations

import shutil
from pathlib import Path
from xml.etree import ElementTree

from network.experiments.comparison import work_out, write_reading
from network.experiments.event_table import EventTable, LoggedEvent


def test_the_map_is_drawn_by_graphviz_or_refused_with_the_next_step(tmp_path: Path) -> None:
    steps = [(0, "IMAGE_RETRIEVE"), (13, "IMAGE_PAIRED"), (2_013, 'A "NAME" -> OF\\nODD LETTERS')]
    table = EventTable.of("by hand", [LoggedEvent(at, activity, "frame-1") for at, activity in steps])
    refusal = write_reading(work_out("ours", table), tmp_path)
    picture = (tmp_path / "process-map.svg").read_text(encoding="utf-8")
    assert ElementTree.fromstring(picture.encode()).tag.endswith("svg")
    assert "IMAGE_PAIRED" in picture
    assert (tmp_path / "process-map.dot").is_file()
    if shutil.which("dot"):
        assert refusal is None
        assert (tmp_path / "process-map.png").read_bytes().startswith(b"\x89PNG")
    else:
        assert refusal is not None
        assert "apt install graphviz" in refusal.next_step
        assert not (tmp_path / "process-map.png").exists()
