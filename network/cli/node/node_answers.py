"""What `blockrobot node init`, `node add` and `certificate` answer with `--json`."""

from __future__ import annotations

from typing import Annotated, Literal

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Height, Hex, doc


class NodeInitAnswer(Answer, frozen=True, kw_only=True):
    """A node whose data directory was made."""

    node: Annotated[str, doc("The node")]
    data_dir: Annotated[str, doc("Its data directory")]
    entry: Annotated[str, doc("The file with its entry, which holds no secret")]
    producer_key: Annotated[Hex, doc("Its producer key")]
    custodian_key: Annotated[Hex, doc("Its custodian key; empty if it is no custodian")]
    next_steps: Annotated[list[str], doc("The next commands to type")]


class NodeAddStep(Answer, frozen=True, kw_only=True):
    """A step in which a node was added."""

    who: Annotated[str, doc("The organisation that did it; empty for this machine")]
    what: Annotated[str, doc("What was done")]
    height: Annotated[Height | None, doc("The block in which it was final; null if it is in none")]


class NodeAddAnswer(Answer, frozen=True, kw_only=True):
    """A node that was added to the local network."""

    node: Annotated[str, doc("The node")]
    organisation: Annotated[str, doc("Whose node it is")]
    steps: Annotated[list[NodeAddStep], doc("What was done")]
    waiting_for: Annotated[list[str], doc("Commands that others have to type")]


class CertificateEntry(Answer, frozen=True, kw_only=True):
    """The certificate of a node."""

    node: Annotated[str, doc("The node")]
    state: Annotated[
        Literal["valid", "expiring", "expired", "revoked", "unusable"],
        doc("`valid`, `expiring`, or why it does not count: `expired`, `revoked` or `unusable`"),
    ]
    organisation: Annotated[str, doc("Whose it is; empty if it cannot be read")]
    serial: Annotated[str, doc("Its serial number, hexadecimal digits; empty if it cannot be read")]
    expires: Annotated[str, doc("Its last day; empty if it cannot be read")]
    days_left: Annotated[int, doc("Whole days until then; negative if it is over, or unknown")]
    trouble: Annotated[str, doc("What is wrong with it; empty if nothing is")]


class CertificateListAnswer(Answer, frozen=True, kw_only=True):
    """The certificates of the nodes. `ok` is false if one does not count."""

    certificates: Annotated[list[CertificateEntry], doc("The certificate of each node")]


class CertificateIssueAnswer(Answer, frozen=True, kw_only=True):
    """A certificate that was issued."""

    node: Annotated[str, doc("The node")]
    serial: Annotated[str, doc("Its serial number, hexadecimal digits")]
    folder: Annotated[str, doc("The folder with it and its key")]


class CertificateRenewAnswer(Answer, frozen=True, kw_only=True):
    """A certificate that was renewed."""

    node: Annotated[str, doc("The node")]
    serial: Annotated[str, doc("Its serial number, hexadecimal digits")]
    expires: Annotated[str, doc("Its last day; empty if it cannot be read")]


ANSWERS: AnswersByCommand = {
    "node init": NodeInitAnswer,
    "node add": NodeAddAnswer,
    "certificate list": CertificateListAnswer,
    "certificate issue": CertificateIssueAnswer,
    "certificate renew": CertificateRenewAnswer,
}
