"""How often a stage of a long run may say something where lines stay."""

from __future__ import annotations

LINE_EVERY_S = 5.0


class Pace:
    """Lets a line pass at most every five seconds for as long as the stage is the same."""

    def __init__(self) -> None:
        self._told_s = 0.0
        self._stage = ""

    def lets_pass(self, line: str, now_s: float) -> bool:
        """Tell whether a line is to be said; `run: 30 frames seen` is of the stage `run`, a line without one is news.

        `now_s` is of a clock that never goes back.
        """
        stage = line.rpartition(": ")[0]
        if stage and stage == self._stage and now_s - self._told_s < LINE_EVERY_S:
            return False
        self._stage, self._told_s = stage, now_s
        return True
