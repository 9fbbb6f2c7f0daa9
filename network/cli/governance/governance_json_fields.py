"""`--json` fields of governance, node, certificate, notice and doctor commands."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind

_HEIGHT_OF_VIEW = Field("height", Kind.HEIGHT, "the block as of which it is proved")
_EPOCH = Field("epoch", Kind.COUNT, "the epoch")
_SINCE = Field("since_height", Kind.HEIGHT, "the first block of that epoch")
_ORGANISATION = Field("organisation", Kind.TEXT, "the organisation")

_PROPOSAL = (
    Field("id", Kind.HEX, "the proposal"),
    Field("kind", Kind.TEXT, "what it asks for"),
    Field("arguments", Kind.OBJECT, "of what, as the contract takes it; bytes in hexadecimal"),
    Field("organisation", Kind.TEXT, "who proposed it"),
    Field("approvals", Kind.TEXTS, "organisations that stand behind it"),
    Field("needed", Kind.COUNT, "how many are needed"),
    Field("height", Kind.HEIGHT, "the block of its proposing"),
    Field("expires_ms", Kind.TIME_MS, "until when it may be approved"),
)
_PROPOSALS = Field("proposals", Kind.ROWS, "open proposals", fields=_PROPOSAL)

_DECISION = (
    Field("height", Kind.HEIGHT, "the block that holds the call"),
    Field("txid", Kind.HEX, "the call", null="if nothing had to be said"),
    Field("executed", Kind.BOOL, "whether a proposal took effect with it"),
    Field("epoch", Kind.COUNT, "the epoch that begins after that block", null="if none does"),
    Field("proposal", Kind.OBJECT, "the proposal", null="if none is left open", fields=_PROPOSAL),
)

_CANDIDATE = (
    Field("key", Kind.HEX, "the producer key"),
    Field("node", Kind.TEXT, "its node"),
    _ORGANISATION,
    Field("status", Kind.TEXT, "`candidate`, `producing`, `suspended` or `retired`"),
    Field("turn", Kind.COUNT, "its turn, from 0", null="if it has no seat"),
    Field("leads", Kind.BOOL, "whether it leads when its turn comes"),
    Field("votes", Kind.TEXTS, "organisations that are for it"),
    Field("removals", Kind.TEXTS, "organisations that are for its removal"),
    Field("ready_height", Kind.HEIGHT, "up to which block it last said that it follows; 0: it never did"),
    Field("ready_ms", Kind.TIME_MS, "when it said so; 0: never"),
    Field("suspended_height", Kind.HEIGHT, "where it was suspended last; 0: never"),
    Field(
        "evidence",
        Kind.OBJECT,
        "what it signed twice",
        null="if nothing",
        fields=(
            Field("kind", Kind.TEXT, "what was signed"),
            Field("epoch", Kind.COUNT, "in which epoch"),
            Field("round", Kind.COUNT, "in which round"),
            Field("producer", Kind.HEX, "by which key"),
            Field("first_id", Kind.HEX, "the one block"),
            Field("first_signature", Kind.HEX, "its signature"),
            Field("second_id", Kind.HEX, "the other block"),
            Field("second_signature", Kind.HEX, "its signature"),
            Field("accuser", Kind.HEX, "the key that entered it on the chain"),
            Field("height", Kind.HEIGHT, "in which block"),
        ),
    ),
)

_ORG = (
    CommandAnswer(
        ("org list",),
        (
            _HEIGHT_OF_VIEW,
            Field("majority", Kind.COUNT, "how many organisations make one"),
            Field(
                "organisations",
                Kind.ROWS,
                "each organisation",
                fields=(
                    Field("name", Kind.TEXT, "its name"),
                    Field("status", Kind.TEXT, "whether it is a member: `active`"),
                    Field("since_height", Kind.HEIGHT, "since which block it is a member"),
                    Field("nodes", Kind.TEXTS, "names of its nodes"),
                ),
            ),
            Field(
                "nodes",
                Kind.ROWS,
                "each node",
                fields=(
                    Field("name", Kind.TEXT, "its name"),
                    _ORGANISATION,
                    Field("host", Kind.TEXT, "where other nodes reach it"),
                    Field("p2p_port", Kind.COUNT, "at which port"),
                    Field("api_url", Kind.TEXT, "where clients reach it"),
                    Field("producer_key", Kind.HEX, "its producer key; empty if it has none"),
                    Field("custodian_key", Kind.HEX, "its custodian key; empty if it has none"),
                    Field("since_height", Kind.HEIGHT, "since which block it is known"),
                ),
            ),
            _PROPOSALS,
        ),
    ),
    CommandAnswer(
        ("org new",),
        (
            Field("folder", Kind.TEXT, "the organisation's folder"),
            Field("entry", Kind.TEXT, "the public half of it, a file"),
            Field("admins", Kind.HEXES, "its admins' keys"),
        ),
    ),
    CommandAnswer(
        (
            *(
                f"org propose {what}"
                for what in (
                    "add-org",
                    "remove-org",
                    "replace-ca",
                    "replace-keys",
                    "add-node",
                    "remove-node",
                    "rekey-producer",
                )
            ),
            "org approve",
            "org withdraw",
            "settings propose",
            "settings approve",
            "settings withdraw",
            "certificate revoke",
        ),
        _DECISION,
    ),
)

_PRODUCERS = (
    CommandAnswer(
        ("producer list",),
        (
            _HEIGHT_OF_VIEW,
            _EPOCH,
            _SINCE,
            Field("max_producers", Kind.COUNT, "how many seats there are at most"),
            Field("votes_needed", Kind.COUNT, "how many votes a seat takes"),
            Field("producers", Kind.ROWS, "each candidate", fields=_CANDIDATE),
        ),
    ),
    CommandAnswer(
        ("producer propose", "producer approve", "producer withdraw", "producer remove"),
        (
            Field("height", Kind.HEIGHT, "the block that holds the call"),
            Field("txid", Kind.HEX, "the call"),
            Field("epoch", Kind.COUNT, "the epoch that begins after that block", null="if none does"),
            Field("producer", Kind.OBJECT, "how it stands now", null="if it is no candidate", fields=_CANDIDATE),
            Field("votes_needed", Kind.COUNT, "how many votes a seat takes"),
        ),
    ),
    CommandAnswer(
        ("settings list",),
        (
            _HEIGHT_OF_VIEW,
            _EPOCH,
            _SINCE,
            Field("settings", Kind.OBJECT, "each setting in force by its name; whole numbers and texts"),
            _PROPOSALS,
        ),
    ),
)

_SERIAL = Field("serial", Kind.TEXT, "its serial number, hexadecimal digits")

_CERTIFICATES = (
    CommandAnswer(
        ("certificate list",),
        (
            Field(
                "certificates",
                Kind.ROWS,
                "each node's",
                fields=(
                    Field("node", Kind.TEXT, "the node"),
                    Field("state", Kind.TEXT, "`valid`, `expiring`, or why it does not count"),
                    Field("organisation", Kind.TEXT, "whose it is; empty if it cannot be read"),
                    Field("serial", Kind.TEXT, "its serial number, hexadecimal digits; empty if it cannot be read"),
                    Field("expires", Kind.TEXT, "its last day; empty if it cannot be read"),
                    Field("days_left", Kind.COUNT, "whole days until then; negative if that is over, or unknown"),
                    Field("trouble", Kind.TEXT, "what is wrong with it; empty if nothing is"),
                ),
            ),
        ),
        not_ok="if one does not count",
    ),
    CommandAnswer(
        ("certificate issue",),
        (Field("node", Kind.TEXT, "the node"), _SERIAL, Field("folder", Kind.TEXT, "where it and its key are")),
    ),
    CommandAnswer(
        ("certificate renew",),
        (Field("node", Kind.TEXT, "the node"), _SERIAL, Field("expires", Kind.TEXT, "its last day")),
    ),
)

_PUBLISHED = (
    _ORGANISATION,
    Field("version", Kind.COUNT, "the notice's version"),
    Field("hash", Kind.HEX, "the hash that stands on the chain"),
    Field("height", Kind.HEIGHT, "the block in which it was published"),
)

_NOTICES = (
    CommandAnswer(("notice new",), (Field("file", Kind.TEXT, "the file that was written"),)),
    CommandAnswer(
        ("notice check",),
        (
            Field("hash", Kind.HEX, "the hash under which it would be published"),
            Field("bytes", Kind.COUNT, "its size in bytes"),
        ),
    ),
    CommandAnswer(
        ("notice publish",),
        (*_PUBLISHED, Field("is_new", Kind.BOOL, "false if it was in force already")),
    ),
    CommandAnswer(
        ("notice show",),
        (
            *_PUBLISHED,
            Field("time_ms", Kind.TIME_MS, "that block's time"),
            Field("lines", Kind.TEXTS, "the notice, a line each"),
        ),
    ),
)

_NODES = (
    CommandAnswer(
        ("node init",),
        (
            Field("node", Kind.TEXT, "the node"),
            Field("data_dir", Kind.TEXT, "its data directory"),
            Field("entry", Kind.TEXT, "its entry, a file without a secret"),
            Field("producer_key", Kind.HEX, "its producer key"),
            Field("custodian_key", Kind.HEX, "its custodian key; empty if it is none"),
            Field("next_steps", Kind.TEXTS, "what to type next"),
        ),
    ),
    CommandAnswer(
        ("node add",),
        (
            Field("node", Kind.TEXT, "the node"),
            _ORGANISATION,
            Field(
                "steps",
                Kind.ROWS,
                "what was done",
                fields=(
                    Field("who", Kind.TEXT, "who did it; empty for this machine"),
                    Field("what", Kind.TEXT, "what"),
                    Field("height", Kind.HEIGHT, "in which block it was final", null="if it stands in none"),
                ),
            ),
            Field("waiting_for", Kind.TEXTS, "commands that others have to type"),
        ),
    ),
    CommandAnswer(
        ("doctor",),
        (
            Field("nodes", Kind.TEXTS, "the nodes that were looked at"),
            Field(
                "findings",
                Kind.ROWS,
                "what was found",
                fields=(
                    Field("code", Kind.TEXT, "[the finding's code](../how-to/when-something-is-wrong.md)"),
                    Field("severity", Kind.TEXT, "`problem` or `warning`"),
                    Field("node", Kind.TEXT, "at which node; empty: at none"),
                    Field("detail", Kind.TEXT, "what was seen"),
                    Field("next_step", Kind.TEXT, "what to do"),
                ),
            ),
            Field("blocks_kept", Kind.TEXTS, "how far back nodes keep blocks, a sentence for those that keep the same"),
        ),
        not_ok="if there is a problem",
    ),
)

_TOOLS = (
    CommandAnswer(
        ("completion",),
        (Field("shell", Kind.TEXT, "the shell"), Field("script", Kind.TEXT, "the script for it")),
    ),
    CommandAnswer(
        ("reference",),
        (
            Field("folder", Kind.TEXT, "the folder of the pages"),
            Field("changed", Kind.TEXTS, "pages that were not current"),
            Field("written", Kind.BOOL, "whether they are now: false with `--check`"),
        ),
        not_ok="if `--check` found a page that is not current",
    ),
)

_FRAMES = (
    CommandAnswer(
        ("frames approve", "frames withdraw"),
        (
            Field("height", Kind.HEIGHT, "the block that holds the last call", null="if nothing was left to do"),
            Field("frames", Kind.HEXES, "the frames, by their SHA-256"),
        ),
    ),
    CommandAnswer(
        ("frames list",),
        (
            Field(
                "frames",
                Kind.ROWS,
                "what is approved, the oldest first",
                fields=(
                    Field("sha256", Kind.HEX, "the frame"),
                    Field("approver", Kind.HEX, "the key of the admin or officer who approved it"),
                    Field("approved_ms", Kind.TIME_MS, "when"),
                ),
            ),
        ),
    ),
)

ANSWERS: tuple[CommandAnswer, ...] = (*_FRAMES, *_ORG, *_PRODUCERS, *_CERTIFICATES, *_NOTICES, *_NODES, *_TOOLS)
"""What these commands answer."""
