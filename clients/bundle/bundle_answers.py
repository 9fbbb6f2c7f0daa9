"""What `blockrobot verify` answers with `--json`."""

from __future__ import annotations

from typing import Annotated

from clients.sdk.terminal.json_answers import Answer, AnswersByCommand, Count, Height, Hex, TimeMs, doc


class SignedReceipt(Answer, frozen=True, kw_only=True):
    """A consent receipt that both sides signed."""

    txid: Annotated[Hex, doc("The transaction that states the consent")]
    handle: Annotated[Hex, doc("The person's handle")]
    status: Annotated[str, doc("`given`, `refused` or `withdrawn`")]
    purposes: Annotated[list[str], doc("Codes of the purposes; empty in a refusal or withdrawal of all")]
    sensors: Annotated[list[str], doc("Codes of the sensors; empty in a refusal or withdrawal of all")]
    height: Annotated[Height, doc("The block that holds it")]
    time_ms: Annotated[TimeMs, doc("That block's time")]
    organisation: Annotated[str, doc("The organisation that signed")]
    node: Annotated[str, doc("Its node that signed")]
    is_registrars: Annotated[bool, doc("Whether it is proved that this organisation registered the person")]
    notice_version: Annotated[
        Count | None, doc("Version of the privacy notice that the person was told; null if none was")
    ]


class VerifyReceiptsAnswer(Answer, frozen=True, kw_only=True):
    """A file of consent receipts that was checked."""

    file: Annotated[str, doc("The file")]
    network: Annotated[str, doc("The network's name")]
    chain_id: Annotated[Hex, doc("Its chain id")]
    genesis_id: Annotated[Hex, doc("Its genesis hash")]
    is_anchored: Annotated[bool, doc("Whether that is the network that `--genesis` names")]
    consent_receipts: Annotated[
        Count,
        doc("How many statements of consent, each with the chain's receipt; of a bundle those after registration"),
    ]
    signed_consent_receipts: Annotated[list[SignedReceipt], doc("Each receipt that both sides signed")]


class StatedProblem(Answer, frozen=True, kw_only=True):
    """What is missing in a bundle, as its exporter says."""

    record_id: Annotated[str, doc("Of which record; empty: of all")]
    code: Annotated[str, doc("The error's code")]
    sentence: Annotated[str, doc("Why")]


class VerifyBundleAnswer(VerifyReceiptsAnswer, frozen=True, kw_only=True):
    """An export bundle that was checked."""

    is_complete: Annotated[bool, doc("Whether its exporter names nothing that is missing")]
    proved_until_height: Annotated[Height, doc("The block as of which all is proved")]
    proved_until_ms: Annotated[TimeMs, doc("That block's time")]
    newest_proof_height: Annotated[Height, doc("The block of the newest proof")]
    visits_proved_until_height: Annotated[list[Height], doc("The block as of which each visit is proved, in order")]
    epochs: Annotated[Count, doc("How many epochs were followed from genesis")]
    stated_created_at_ms: Annotated[TimeMs, doc("When it was made, as it says")]
    visits: Annotated[Count, doc("How many visits")]
    records: Annotated[Count, doc("How many records")]
    metadata_proved: Annotated[Count, doc("Of how many records the metadata are proved to be what the robot sealed")]
    pictures: Annotated[Count, doc("How many pictures, labels and sounds")]
    audit_entries: Annotated[Count, doc("How many events in the audit trail")]
    accesses: Annotated[Count, doc("How many requests for pictures")]
    erasures: Annotated[Count, doc("How many requests for erasure")]
    member: Annotated[str, doc("The person's member key; empty if the bundle does not name them")]
    visits_of_member: Annotated[list[Count], doc("Numbers of the visits that are proved to be that member's")]
    signed_by: Annotated[list[Hex], doc("Keys that signed the bundle")]
    stated_problems: Annotated[list[StatedProblem], doc("What is missing, as its exporter says")]
    not_proved: Annotated[list[str], doc("What it leaves open, a sentence each")]


ANSWERS: AnswersByCommand = {"verify": (VerifyBundleAnswer, VerifyReceiptsAnswer)}
