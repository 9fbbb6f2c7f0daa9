"""Counts the frames between this node and each peer, by direction and kind.

A frame sent is counted when it leaves the queue of its connection: before a link fault could lose it. A frame received
is counted when it is whole. A count is two additions; Prometheus' own objects would cost ten times that for each frame.
"""

from __future__ import annotations

from typing import Literal

from node.p2p.wire import FrameKind

Direction = Literal["sent", "received"]
_KINDS = {int(kind): kind.name.lower() for kind in FrameKind}
_FRAMES, _BYTES = "blockrobot_peer_frames_total", "blockrobot_peer_bytes_total"


class Traffic:
    """The counts of one node since its start. On the event loop only."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, Direction, int], list[int]] = {}

    def note(self, peer: str, direction: Direction, kind: int, size_bytes: int) -> None:
        """Count one frame of so many bytes. `kind` is its type byte, also one that stands for nothing."""
        count = self._counts.get((peer, direction, kind))
        if count is None:
            count = self._counts[(peer, direction, kind)] = [0, 0]
        count[0] += 1
        count[1] += size_bytes

    def render(self) -> bytes:
        """Return the counts in the Prometheus text format."""
        lines = []
        for place, (name, description) in enumerate(
            ((_FRAMES, "Frames between this node and a peer."), (_BYTES, "Bytes of these frames."))
        ):
            lines += [f"# HELP {name} {description}", f"# TYPE {name} counter"]
            for (peer, direction, kind), count in sorted(self._counts.items()):
                labels = f'peer="{_escape(peer)}",direction="{direction}",kind="{_KINDS.get(kind, "unknown")}"'
                lines.append(f"{name}{{{labels}}} {count[place]}")
        return ("\n".join(lines) + "\n").encode()


def _escape(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
