"""What the commands by which organisations govern a network answer with `--json`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import field

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, TimeMs, doc


class OpenProposal(Answer, frozen=True, kw_only=True):
    """A proposal that is open."""

    id: Annotated[Hex, doc("The proposal")]
    kind: Annotated[str, doc("What it asks for")]
    arguments: Annotated[dict[str, Any], doc("The arguments of the contract; bytes in hexadecimal")]
    organisation: Annotated[str, doc("Who proposed it")]
    approvals: Annotated[list[str], doc("Organisations that approved it")]
    needed: Annotated[Count, doc("How many approvals are needed")]
    height: Annotated[Height, doc("The block in which it was proposed")]
    expires_ms: Annotated[TimeMs, doc("Until when it may be approved")]


class DecisionAnswer(Answer, frozen=True, kw_only=True):
    """A change that was proposed, approved or withdrawn."""

    height: Annotated[Height, doc("The block that holds the call")]
    txid: Annotated[Hex, doc("The call")]
    executed: Annotated[bool, doc("Whether a proposal took effect with it")]
    epoch: Annotated[Count | None, doc("The epoch that begins after that block; null if none does")]
    proposal: Annotated[OpenProposal | None, doc("The proposal; null if it is not open any more")]


class MemberOrganisation(Answer, frozen=True, kw_only=True):
    """An organisation of the network."""

    name: Annotated[str, doc("Its name")]
    status: Annotated[Literal["active", "removed"], doc("Whether it is a member: `active`")]
    since_height: Annotated[Height, doc("Since which block it is a member")]
    authorities: Annotated[list[Hex], doc("SHA-256 of each certificate of its authority")]
    nodes: Annotated[list[str], doc("Names of its nodes")]


class MemberNode(Answer, frozen=True, kw_only=True):
    """A node of the network, as the chain knows it."""

    name: Annotated[str, doc("Its name")]
    organisation: Annotated[str, doc("Whose node it is")]
    host: Annotated[str, doc("Where other nodes reach it")]
    p2p_port: Annotated[Count, doc("At which port")]
    api_url: Annotated[str, doc("Where clients reach it")]
    producer_key: Annotated[Hex, doc("Its producer key; empty if it has none")]
    custodian_key: Annotated[Hex, doc("Its custodian key; empty if it has none")]
    since_height: Annotated[Height, doc("Since which block it is known")]


class OrgListAnswer(Answer, frozen=True, kw_only=True):
    """Organisations, nodes and the open proposals about them."""

    height: Annotated[Height, doc("The block as of which it is proved")]
    majority: Annotated[Count, doc("How many organisations make a majority")]
    organisations: Annotated[list[MemberOrganisation], doc("Each organisation")]
    nodes: Annotated[list[MemberNode], doc("Each node")]
    proposals: Annotated[list[OpenProposal], doc("Open proposals")]


class OrgNewAnswer(Answer, frozen=True, kw_only=True):
    """An organisation whose keys were made."""

    folder: Annotated[str, doc("The organisation's folder")]
    entry: Annotated[str, doc("The file with its entry, which holds no secret")]
    admins: Annotated[list[Hex], doc("Its admins' keys")]


class GenesisNode(Answer, frozen=True, kw_only=True):
    """A node that a genesis file names."""

    name: Annotated[str, doc("Its name")]
    organisation: Annotated[str, doc("Whose node it is")]
    host: Annotated[str, doc("Where other nodes reach it")]
    p2p_port: Annotated[Count, doc("At which port")]
    api_url: Annotated[str, doc("Where clients reach it")]
    produces: Annotated[bool, doc("Whether it has a seat from the beginning")]
    is_custodian: Annotated[bool, doc("Whether it keeps off-chain data")]


class GenesisOrganisation(Answer, frozen=True, kw_only=True):
    """An organisation that founds a network."""

    name: Annotated[str, doc("Its name")]
    nodes: Annotated[list[str], doc("Its nodes")]
    custodians: Annotated[list[str], doc("Those that keep off-chain data")]
    authorities: Annotated[list[Hex], doc("SHA-256 of each certificate of its authority")]
    admins: Annotated[list[Hex], doc("Keys that speak for it where the network is governed")]
    registrars: Annotated[list[Hex], doc("Keys that let people in")]


class GenesisWarning(Answer, frozen=True, kw_only=True):
    """What founders may not have meant."""

    code: Annotated[str, doc("Its code")]
    detail: Annotated[str, doc("What there is to see")]


class GenesisAnswer(Answer, frozen=True, kw_only=True):
    """A genesis file that was made or checked."""

    file: Annotated[str, doc("The file")]
    network: Annotated[str, doc("What the network is called")]
    chain_id: Annotated[Hex, doc("The network's id, which follows from the file")]
    fingerprint: Annotated[str, doc("What all parties have to see alike")]
    begins_ms: Annotated[TimeMs, doc("When it begins: no block is earlier")]
    settings: Annotated[dict[str, int | str], doc("Each setting by its name")]
    changed_settings: Annotated[list[str], doc("Those that are not the default")]
    purposes: Annotated[list[str], doc("For what people may be recorded and recordings looked at")]
    organisations: Annotated[list[GenesisOrganisation], doc("The founding organisations")]
    nodes: Annotated[list[GenesisNode], doc("Their nodes")]
    warnings: Annotated[list[GenesisWarning], doc("What founders may not have meant")]
    adopted: Annotated[list[str], doc("Nodes here that begin with it")]
    replaced: Annotated[bool, doc("Whether they had another genesis file, by which none had started")]


class EpochView(Answer, frozen=True, kw_only=True):
    """The epoch in which something holds."""

    height: Annotated[Height, doc("The block as of which it is proved")]
    epoch: Annotated[Count, doc("The epoch")]
    since_height: Annotated[Height, doc("The first block of that epoch")]


class SettingsListAnswer(EpochView, frozen=True, kw_only=True):
    """The settings in force and the open proposals about them."""

    settings: Annotated[dict[str, int | str], doc("Each setting by its name")]
    proposals: Annotated[list[OpenProposal], doc("Open proposals")]


class Equivocation(Answer, frozen=True, kw_only=True):
    """The evidence that a producer signed two different things in one round."""

    kind: Annotated[str, doc("What was signed")]
    epoch: Annotated[Count, doc("In which epoch")]
    round: Annotated[Count, doc("In which round")]
    producer: Annotated[Hex, doc("By which key")]
    first_id: Annotated[Hex, doc("The one block")]
    first_signature: Annotated[Hex, doc("Its signature")]
    second_id: Annotated[Hex, doc("The other block")]
    second_signature: Annotated[Hex, doc("Its signature")]
    accuser: Annotated[Hex, doc("The key that entered it on the chain")]
    height: Annotated[Height, doc("In which block")]


class ProducerCandidate(Answer, frozen=True, kw_only=True):
    """A producer of blocks, or a candidate."""

    key: Annotated[Hex, doc("The producer key")]
    node: Annotated[str, doc("Its node")]
    organisation: Annotated[str, doc("Whose node it is")]
    status: Annotated[
        Literal["candidate", "producing", "suspended", "removed"],
        doc("`candidate`, `producing`, `suspended` or `removed`"),
    ]
    turn: Annotated[Count | None, doc("Its turn, from 0; null if it has no seat")]
    leads: Annotated[bool, doc("Whether it leads when its turn comes")]
    votes: Annotated[list[str], doc("Organisations that voted for it")]
    removals: Annotated[list[str], doc("Organisations that voted for its removal")]
    ready_height: Annotated[Height, doc("Up to which block it last said that it follows; 0 if it never did")]
    ready_ms: Annotated[TimeMs, doc("When it said so; 0 if it never did")]
    suspended_height: Annotated[Height, doc("Where it was suspended last; 0 if it never was")]
    evidence: Annotated[Equivocation | None, doc("How it equivocated; null if it did not")]


class ProducerListAnswer(EpochView, frozen=True, kw_only=True):
    """Producers and candidates."""

    max_producers: Annotated[Count, doc("How many seats there are at most")]
    votes_needed: Annotated[Count, doc("How many votes a seat takes")]
    producers: Annotated[list[ProducerCandidate], doc("Each producer and candidate")]


class ProducerVoteAnswer(Answer, frozen=True, kw_only=True):
    """A vote on a producer."""

    height: Annotated[Height, doc("The block that holds the call")]
    txid: Annotated[Hex, doc("The call")]
    epoch: Annotated[Count | None, doc("The epoch that begins after that block; null if none does")]
    producer: Annotated[ProducerCandidate | None, doc("The producer's state after it; null if it is no candidate")]
    votes_needed: Annotated[Count, doc("How many votes a seat takes")]


class FramesDecisionAnswer(Answer, frozen=True, kw_only=True):
    """Empty frames that were approved or withdrawn."""

    height: Annotated[Height | None, doc("The block that holds the last call; null if nothing was left to do")]
    frames: Annotated[list[Hex], doc("The frames, by their SHA-256")]


class ApprovedFrame(Answer, frozen=True, kw_only=True):
    """An empty frame that a robot may publish."""

    sha256: Annotated[Hex, doc("The frame")]
    approver: Annotated[Hex, doc("The key of the admin or officer who approved it")]
    approved_ms: Annotated[TimeMs, doc("When")]


class FramesListAnswer(Answer, frozen=True, kw_only=True):
    """The empty frames that a robot may publish."""

    frames: Annotated[list[ApprovedFrame], doc("Each frame, the oldest first")]


class NoticeNewAnswer(Answer, frozen=True, kw_only=True):
    """A notice to be changed into one's own."""

    file: Annotated[str, doc("The file that was written")]


class NoticeCheckAnswer(Answer, frozen=True, kw_only=True):
    """A notice that is complete."""

    hash: Annotated[Hex, doc("The hash under which it would be published")]
    bytes: Annotated[Count, doc("Its size in bytes")]


class NoticeVersionAnswer(Answer, frozen=True, kw_only=True):
    """A version of a notice on the chain."""

    organisation: Annotated[str, doc("Whose notice it is")]
    version: Annotated[Count, doc("The notice's version")]
    hash: Annotated[Hex, doc("Its hash on the chain")]
    height: Annotated[Height, doc("The block in which it was published")]


class NoticePublishAnswer(NoticeVersionAnswer, frozen=True, kw_only=True):
    """A notice that is in force."""

    is_new: Annotated[bool, doc("Whether it was published now; false if it was in force already")]


class NoticeShowAnswer(NoticeVersionAnswer, frozen=True, kw_only=True):
    """What an organisation tells people."""

    time_ms: Annotated[TimeMs, doc("That block's time")]
    lines: Annotated[list[str], doc("The notice, line by line")]


class NoticeParty(Answer, frozen=True, kw_only=True):
    """Somebody whom a notice names."""

    name: Annotated[str, doc("Their name")]
    address: Annotated[str, doc("Their address")]
    contact: Annotated[str, doc("How they are reached")]


class NoticeReference(Answer, frozen=True, kw_only=True):
    """A notice, by its version."""

    version: Annotated[Count, doc("Its version")]
    hash: Annotated[Hex, doc("Its hash on the chain")]


class ProcessingActivity(Answer, frozen=True, kw_only=True):
    """A processing activity."""

    name: Annotated[str, doc("Its purpose's code")]
    purpose: Annotated[str, doc("Its purpose in words")]
    lawful_basis: Annotated[str, doc("The ground of Art. 6")]
    special_basis: Annotated[str, doc("The ground of Art. 9 for special categories")]
    sensors: Annotated[list[str], doc("The sensors that record for it")]
    storage_days: Annotated[Count, doc("For how many days it is kept; 0 if nothing is recorded")]


class DataCategory(Answer, frozen=True, kw_only=True):
    """A category of data."""

    what: Annotated[str, doc("What it is")]
    from_: Annotated[str, doc("Where it comes from")] = field(name="from")


class DataRecipient(Answer, frozen=True, kw_only=True):
    """Who gets data."""

    who: Annotated[str, doc("Who")]
    what: Annotated[str, doc("Which data")]
    why: Annotated[str, doc("Why")]


class DataRetention(Answer, frozen=True, kw_only=True):
    """How long data is kept."""

    what: Annotated[str, doc("Which data")]
    how_long: Annotated[str, doc("How long")]


class ProcessingPlace(Answer, frozen=True, kw_only=True):
    """A node at which data is processed."""

    name: Annotated[str, doc("The node")]
    organisation: Annotated[str, doc("Whose node it is")]
    address: Annotated[str, doc("Where clients reach it")]
    keeps_clips: Annotated[bool, doc("Whether it keeps encrypted clips")]


class NoticeActivitiesAnswer(Answer, frozen=True, kw_only=True):
    """The register of processing activities (GDPR Art. 30)."""

    organisation: Annotated[str, doc("Whose register it is")]
    height: Annotated[Height, doc("The block as of which it is")]
    time_ms: Annotated[TimeMs, doc("That block's time")]
    notice: Annotated[NoticeReference, doc("The notice in force")]
    controller: Annotated[NoticeParty, doc("The controller")]
    joint_controllers: Annotated[list[NoticeParty], doc("Joint controllers")]
    officer: Annotated[NoticeParty, doc("The data protection officer")]
    activities: Annotated[list[ProcessingActivity], doc("Each activity")]
    data_subjects: Annotated[list[str], doc("Categories of data subjects")]
    categories: Annotated[list[DataCategory], doc("Categories of data")]
    recipients: Annotated[list[DataRecipient], doc("Recipients")]
    other_keepers: Annotated[list[str], doc("Other organisations whose nodes keep encrypted clips")]
    third_countries: Annotated[str, doc("Whether data goes to third countries")]
    retention: Annotated[list[DataRetention], doc("Time limits for erasure")]
    measures: Annotated[list[str], doc("Measures of security")]
    places: Annotated[list[ProcessingPlace], doc("Each node")]
    open: Annotated[list[str], doc("What no program knows and people have to fill in")]
    file: Annotated[str | None, doc("The file that was written; null without `--out`")]


ANSWERS: AnswersByCommand = {
    "org list": OrgListAnswer,
    "org new": OrgNewAnswer,
    "genesis make": GenesisAnswer,
    "genesis check": GenesisAnswer,
    "org propose add-org": DecisionAnswer,
    "org propose remove-org": DecisionAnswer,
    "org propose replace-ca": DecisionAnswer,
    "org propose replace-keys": DecisionAnswer,
    "org propose add-node": DecisionAnswer,
    "org propose remove-node": DecisionAnswer,
    "org propose move-node": DecisionAnswer,
    "org propose rekey-producer": DecisionAnswer,
    "org approve": DecisionAnswer,
    "org withdraw": DecisionAnswer,
    "settings list": SettingsListAnswer,
    "settings propose": DecisionAnswer,
    "settings approve": DecisionAnswer,
    "settings withdraw": DecisionAnswer,
    "certificate revoke": DecisionAnswer,
    "producer list": ProducerListAnswer,
    "producer propose": ProducerVoteAnswer,
    "producer approve": ProducerVoteAnswer,
    "producer withdraw": ProducerVoteAnswer,
    "producer remove": ProducerVoteAnswer,
    "frames approve": FramesDecisionAnswer,
    "frames withdraw": FramesDecisionAnswer,
    "frames list": FramesListAnswer,
    "notice new": NoticeNewAnswer,
    "notice check": NoticeCheckAnswer,
    "notice publish": NoticePublishAnswer,
    "notice show": NoticeShowAnswer,
    "notice activities": NoticeActivitiesAnswer,
}
