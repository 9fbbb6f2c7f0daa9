"""JSON fields of `blockrobot verify --json`."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind

_FOR_RECEIPTS = "for a file of consent receipts"

_SIGNED_RECEIPT = (
    Field("txid", Kind.HEX, "the word's transaction"),
    Field("handle", Kind.HEX, "the person's handle"),
    Field("status", Kind.TEXT, "`given`, `refused` or `withdrawn`"),
    Field("purposes", Kind.TEXTS, "purposes' codes; none in a no: all"),
    Field("sensors", Kind.TEXTS, "sensors' codes; none in a no: all"),
    Field("height", Kind.HEIGHT, "the block that holds it"),
    Field("time_ms", Kind.TIME_MS, "that block's time"),
    Field("organisation", Kind.TEXT, "the organisation that signed"),
    Field("node", Kind.TEXT, "its node that did"),
    Field("is_registrars", Kind.BOOL, "whether it is proved that this organisation had registered the person"),
    Field("notice_version", Kind.COUNT, "the notice that she was told", null="if none was published"),
)

ANSWERS: tuple[CommandAnswer, ...] = (
    CommandAnswer(
        ("verify",),
        (
            Field("file", Kind.TEXT, "the file"),
            Field("network", Kind.TEXT, "the network's name"),
            Field("chain_id", Kind.HEX, "its chain id"),
            Field("genesis_id", Kind.HEX, "its genesis hash"),
            Field("is_anchored", Kind.BOOL, "whether that is the network that `--genesis` names"),
            Field("is_complete", Kind.BOOL, "whether its exporter names nothing that is missing", absent=_FOR_RECEIPTS),
            Field("proved_until_height", Kind.HEIGHT, "the block as of which it is proved", absent=_FOR_RECEIPTS),
            Field("proved_until_ms", Kind.TIME_MS, "that block's time", absent=_FOR_RECEIPTS),
            Field("newest_proof_height", Kind.HEIGHT, "the block of the newest proof", absent=_FOR_RECEIPTS),
            Field(
                "visits_proved_until_height",
                Kind.COUNTS,
                "the block as of which each visit is told, in their order",
                absent=_FOR_RECEIPTS,
            ),
            Field("epochs", Kind.COUNT, "how many epochs were followed from genesis", absent=_FOR_RECEIPTS),
            Field("stated_created_at_ms", Kind.TIME_MS, "when it was made, as it says", absent=_FOR_RECEIPTS),
            Field("visits", Kind.COUNT, "how many visits", absent=_FOR_RECEIPTS),
            Field("records", Kind.COUNT, "how many records", absent=_FOR_RECEIPTS),
            Field(
                "metadata_proved",
                Kind.COUNT,
                "of how many records the metadata are what the robot sealed",
                absent=_FOR_RECEIPTS,
            ),
            Field("pictures", Kind.COUNT, "how many pictures, labels and sounds", absent=_FOR_RECEIPTS),
            Field("audit_entries", Kind.COUNT, "how many events", absent=_FOR_RECEIPTS),
            Field("accesses", Kind.COUNT, "how many requests for pictures", absent=_FOR_RECEIPTS),
            Field("erasures", Kind.COUNT, "how many requests for erasure", absent=_FOR_RECEIPTS),
            Field("member", Kind.TEXT, "the person's member key; empty if it does not name her", absent=_FOR_RECEIPTS),
            Field(
                "visits_of_member",
                Kind.COUNTS,
                "numbers of the visits that are proved to be that member's",
                absent=_FOR_RECEIPTS,
            ),
            Field(
                "consent_receipts",
                Kind.COUNT,
                "how many words on consent, each with the chain's receipt; of an export those from after registering",
            ),
            Field(
                "signed_consent_receipts",
                Kind.ROWS,
                "each receipt that both sides signed",
                fields=_SIGNED_RECEIPT,
            ),
            Field("signed_by", Kind.HEXES, "keys that signed the bundle", absent=_FOR_RECEIPTS),
            Field(
                "stated_problems",
                Kind.ROWS,
                "what is missing, as its exporter says",
                absent=_FOR_RECEIPTS,
                fields=(
                    Field("record_id", Kind.TEXT, "of which record; empty: of all"),
                    Field("code", Kind.TEXT, "the error's code"),
                    Field("sentence", Kind.TEXT, "why"),
                ),
            ),
            Field("not_proved", Kind.TEXTS, "what it leaves open, a sentence each", absent=_FOR_RECEIPTS),
        ),
    ),
)
"""What this command answers."""
