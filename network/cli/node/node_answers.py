"""What `blockrobot node` and `certificate` answer with `--json`."""

from __future__ import annotations

from typing import Annotated, Literal

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, TimeMs, doc
from network.ledger_diff.difference_answers import NodeDiffAnswer


class ListeningWarning(Answer, frozen=True, kw_only=True):
    """Why a new node could not listen now where it is to."""

    code: Annotated[str, doc("Its code")]
    detail: Annotated[str, doc("What there is to see")]


class NodeInitAnswer(Answer, frozen=True, kw_only=True):
    """A node whose data directory was made."""

    node: Annotated[str, doc("The node")]
    data_dir: Annotated[str, doc("Its data directory")]
    entry: Annotated[
        str, doc("The file with its entry, which holds no secret; without a certificate it is not there yet")
    ]
    request: Annotated[str | None, doc("The file with its request for a certificate; null if it has a certificate")]
    producer_key: Annotated[Hex, doc("Its producer key")]
    custodian_key: Annotated[Hex, doc("Its custodian key; empty if it is no custodian")]
    next_steps: Annotated[list[str], doc("The next commands to type")]
    warnings: Annotated[list[ListeningWarning], doc("Why it could not listen now")]


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


class NodeRunAnswer(Answer, frozen=True, kw_only=True):
    """A node that was started with `--detach`."""

    node: Annotated[str, doc("The node")]
    data_dir: Annotated[str, doc("Its data directory")]


class DirectoryNode(Answer, frozen=True, kw_only=True):
    """A node, as the chain of another knows it."""

    name: Annotated[str, doc("Its name")]
    organisation: Annotated[str, doc("Whose node it is")]
    host: Annotated[str, doc("Where other nodes reach it")]
    p2p_port: Annotated[Count, doc("At which port")]
    api_url: Annotated[str, doc("Where clients reach it")]
    producer_key: Annotated[Hex, doc("Its producer key; empty if it has none")]
    custodian_key: Annotated[Hex, doc("Its custodian key; empty if it has none")]
    is_active: Annotated[bool, doc("Whether it belongs to the network; false if it was removed")]
    since_height: Annotated[Height, doc("Since which block")]


class DirectoryOrganisation(Answer, frozen=True, kw_only=True):
    """An organisation, as the chain of a node knows it."""

    name: Annotated[str, doc("Its name")]
    ca_certificate: Annotated[str, doc("The certificate of its authority, as PEM")]
    is_active: Annotated[bool, doc("Whether it is a member; false if it was removed")]


class NodeDirectoryAnswer(Answer, frozen=True, kw_only=True):
    """The nodes and organisations that a node knows: what `--out` writes."""

    chain_id: Annotated[Hex, doc("The network")]
    height: Annotated[Height, doc("The block as of which it is")]
    nodes: Annotated[list[DirectoryNode], doc("Each node")]
    organisations: Annotated[list[DirectoryOrganisation], doc("Each organisation")]
    revoked: Annotated[list[tuple[str, str]], doc("Revoked certificates: organisation and serial number")]


class NodePruneAnswer(Answer, frozen=True, kw_only=True):
    """A node whose old blocks were dropped."""

    node: Annotated[str, doc("The node")]
    height: Annotated[Height, doc("Its newest block")]
    earliest_height: Annotated[Height, doc("The oldest block whose body it has now")]
    held_back_by_custody: Annotated[bool, doc("Whether older blocks stay, since its custodian has not followed them")]


class NodeMoveCustodyAnswer(Answer, frozen=True, kw_only=True):
    """A custodian whose clips are at another place, or whose move was given up."""

    node: Annotated[str, doc("The node")]
    clips: Annotated[Count, doc("How many clips were copied; of a move that is given up 0")]
    frames: Annotated[Count, doc("How many pictures these have")]
    old: Annotated[str, doc("What it kept before, to be deleted; empty if the move is given up")]
    left: Annotated[list[str], doc("Databases, buckets and folders that it was moved away from, left as they were")]


class SnapshotManifest(Answer, frozen=True, kw_only=True):
    """What a snapshot says of itself."""

    chain_id: Annotated[Hex, doc("The network")]
    height: Annotated[Height, doc("The block whose state it is")]
    epoch: Annotated[Count, doc("That block's epoch")]
    epochs_proved: Annotated[list[Count], doc("The epochs whose proofs are in it")]
    timestamp_ms: Annotated[TimeMs, doc("That block's time")]
    block_id: Annotated[Hex, doc("That block")]
    state_root: Annotated[Hex, doc("The root of the state")]
    names_its_proof: Annotated[bool, doc("Whether its proof of finality is about that block")]
    state_rows: Annotated[Count, doc("How many rows the state has")]
    recent_blocks: Annotated[Count, doc("How many blocks before it are in it")]
    chunks: Annotated[Count, doc("How many chunks it has")]
    size_bytes: Annotated[Count, doc("Its size")]


class SnapshotCreateAnswer(SnapshotManifest, frozen=True, kw_only=True):
    """A snapshot that was made."""

    folder: Annotated[str, doc("Its folder")]


class SnapshotRestoreAnswer(SnapshotManifest, frozen=True, kw_only=True):
    """A snapshot that is a node's ledger now."""

    node: Annotated[str, doc("The node")]


class SnapshotShowAnswer(SnapshotManifest, frozen=True, kw_only=True):
    """A snapshot."""

    verified: Annotated[bool, doc("Whether all of it was verified, with `--genesis`")]


class NodeBackupAnswer(Answer, frozen=True, kw_only=True):
    """A node that was backed up."""

    node: Annotated[str, doc("The node")]
    folder: Annotated[str, doc("The backup")]
    height: Annotated[Height, doc("The block up to which its ledger is in it")]
    files: Annotated[Count, doc("How many files it has")]
    has_keys: Annotated[bool, doc("Whether the node's keys are in it")]
    has_custody: Annotated[bool, doc("Whether what it keeps as a custodian is in it")]
    store_elsewhere: Annotated[bool, doc("Whether it keeps that in MongoDB, which needs a backup of its own")]
    clips_elsewhere: Annotated[str, doc("Where its clips' ciphertexts are, which are not in it; empty: they are")]
    password_left_out: Annotated[
        bool, doc("Whether node.toml holds a password or login of MongoDB, which is not in the backup")
    ]
    deleted: Annotated[list[str], doc("The older backups that `--keep` deleted")]


class NodeRestoreAnswer(Answer, frozen=True, kw_only=True):
    """A node that was made of a backup."""

    node: Annotated[str, doc("The node")]
    data_dir: Annotated[str, doc("Its data directory")]
    height: Annotated[Height, doc("The block up to which its ledger is there")]
    has_custody: Annotated[bool, doc("Whether what it kept as a custodian is there")]
    fingerprint: Annotated[str, doc("Of its network's genesis file, as `genesis check` shows it")]
    settings: Annotated[
        dict[str, str | int | bool | list[str]],
        doc("What its node.toml says; of paths, those outside of its folder, and what its clips' server is asked with"),
    ]
    changed_settings: Annotated[list[str], doc("Those that are not the default, or have none")]
    next_step: Annotated[str, doc("The command that starts it")]
    warning: Annotated[
        str,
        doc(
            "What to know before: of two or three producers one would stop the network, and a key that the backup does not "
            "know may be wrong; else empty"
        ),
    ]


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


class CertificateRequestAnswer(Answer, frozen=True, kw_only=True):
    """A request for a certificate."""

    node: Annotated[str, doc("The node")]
    organisation: Annotated[str, doc("Whose authority is to sign it")]
    hosts: Annotated[list[str], doc("The addresses that it names besides the node's name")]
    file: Annotated[str, doc("The request, which holds no secret")]


class CertificateSignAnswer(Answer, frozen=True, kw_only=True):
    """A certificate that was issued for a request."""

    node: Annotated[str, doc("The node")]
    serial: Annotated[str, doc("Its serial number, hexadecimal digits")]
    hosts: Annotated[list[str], doc("The addresses that it names besides the node's name")]
    file: Annotated[str, doc("The certificate")]


class CertificateRenewAnswer(Answer, frozen=True, kw_only=True):
    """A certificate that was renewed."""

    node: Annotated[str, doc("The node")]
    serial: Annotated[str, doc("Its serial number, hexadecimal digits")]
    expires: Annotated[str, doc("Its last day; empty if it cannot be read")]


ANSWERS: AnswersByCommand = {
    "node init": NodeInitAnswer,
    "node add": NodeAddAnswer,
    "node run": NodeRunAnswer,
    "node directory": NodeDirectoryAnswer,
    "node move-custody": NodeMoveCustodyAnswer,
    "node prune": NodePruneAnswer,
    "node snapshot create": SnapshotCreateAnswer,
    "node snapshot restore": SnapshotRestoreAnswer,
    "node snapshot show": SnapshotShowAnswer,
    "node diff": NodeDiffAnswer,
    "node backup": NodeBackupAnswer,
    "node restore": NodeRestoreAnswer,
    "certificate list": CertificateListAnswer,
    "certificate issue": CertificateIssueAnswer,
    "certificate request": CertificateRequestAnswer,
    "certificate sign": CertificateSignAnswer,
    "certificate install": CertificateRenewAnswer,
    "certificate renew": CertificateRenewAnswer,
}
