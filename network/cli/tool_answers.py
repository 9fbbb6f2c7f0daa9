"""What `blockrobot completion` and `reference` answer with `--json`."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, doc


class CompletionAnswer(Answer, frozen=True, kw_only=True):
    """The completion script of a shell."""

    shell: Annotated[str, doc("The shell")]
    script: Annotated[str, doc("The script for it")]


class ReferenceAnswer(Answer, frozen=True, kw_only=True):
    """The reference pages. `ok` is false if `--check` found a page that is not current."""

    folder: Annotated[str, doc("The folder of the pages")]
    changed: Annotated[list[str], doc("Pages that were not current")]
    written: Annotated[bool, doc("Whether they are now: false with `--check`")]


ANSWERS: AnswersByCommand = {"completion": CompletionAnswer, "reference": ReferenceAnswer}
