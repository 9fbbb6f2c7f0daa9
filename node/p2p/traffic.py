"""Counts frames per peer, direction and kind: sent when dequeued, received when whole."""

from __future__ import annotations

from typing import Literal

from node.p2p.wire import FrameKind

Direction = Literal["sent", "received"]
_KINDS = {int(kind): kind.name.lower() for kind in FrameKind}
_FRAMES, _BYTES = "blockrobot_peer_frames_total", "blockrobot_peer_bytes_total"


class Traffic:
    """Counts of one node since its start. On the event loop only."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, Direction, int], list[int]] = {}

    def note(self, peer: str, direction: Direction, kind: int, size_bytes: int) -> None:
        """`kind` is the type byte, even an unknown one."""
        count = self._counts.get((peer, direction, kind))
        if count is None:
            count = self._counts[(peer, direction, kind)] = [0, 0]
        count[0] += 1
        count[1] += size_bytes

    def render(self) -> bytes:
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
