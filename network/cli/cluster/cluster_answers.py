"""What the commands about a network on this machine answer with `--json`."""

from __future__ import annotations

from typing import Annotated, Literal

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, doc


class DoctorFinding(Answer, frozen=True, kw_only=True):
    """A finding of the doctor."""

    code: Annotated[str, doc("The finding's code: docs/how-to/when-something-is-wrong.md")]
    severity: Annotated[Literal["problem", "warning"], doc("`problem` or `warning`")]
    node: Annotated[str, doc("At which node; empty for the whole network")]
    detail: Annotated[str, doc("What was seen")]
    next_step: Annotated[str, doc("What to do")]


class DoctorAnswer(Answer, frozen=True, kw_only=True):
    """What is wrong with a network or a node. `ok` is false if there is a problem."""

    nodes: Annotated[list[str], doc("The nodes that were examined")]
    findings: Annotated[list[DoctorFinding], doc("What was found")]
    blocks_kept: Annotated[list[str], doc("How far back nodes keep blocks, a sentence for those that keep the same")]


ANSWERS: AnswersByCommand = {"doctor": DoctorAnswer}
