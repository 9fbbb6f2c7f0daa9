"""Wallet `--json` fields: records, rights, consent, wallet. Sharing: `clients.wallet.present.sharing_json_fields`."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind

SPOKEN_FOR = (
    Field("for", Kind.HEX, "the handle of the person for whom it was said", null="if for oneself"),
    Field("mandate_id", Kind.HEX, "the mandate under which it was said", null="if for oneself"),
)

VISIT = Field("visit", Kind.HEX, "the visit's name: its first owner key")
TXID = Field("txid", Kind.HEX, "the transaction")
HEIGHT = Field("height", Kind.HEIGHT, "the block that holds it")
TIME = Field("time_ms", Kind.TIME_MS, "that block's time")

_AT_ITS_END = "when it ends"
_WALLET = Field("wallet", Kind.TEXT, "the wallet's file")
_MEMBER = Field("member", Kind.HEX, "the member key")
CHECKED = "whether the network said which words are in force; it is asked only where former words are named"
_WORDS_CHECKED = Field("words_checked", Kind.BOOL, CHECKED)

_SAID = (
    VISIT,
    Field("records", Kind.HEXES, "ids of the records that are meant; none: the whole visit"),
    TXID,
    HEIGHT,
    TIME,
)
"""A word about one visit, as `rights_commands.said_json` tells it."""

_RECORD = (
    Field("record_id", Kind.HEX, "the record"),
    VISIT,
    Field("status", Kind.TEXT, "`active`, or `erasing` once its erasure is asked for"),
    Field("sensor", Kind.TEXT, "which sensor took it; `notice` for a note of what was withheld"),
    Field("started_at_ms", Kind.TIME_MS, "its beginning, by the robot's clock"),
    Field("ended_at_ms", Kind.TIME_MS, "its end, by the robot's clock"),
    Field("frames", Kind.COUNT, "how many pictures, labels or sounds it has"),
    Field("erased_numbers", Kind.COUNTS, "places in the record of those that are erased, from 1"),
    Field("index_in_visit", Kind.COUNT, "its place in the visit, from 0"),
    Field("expires_at_ms", Kind.TIME_MS, "when its time is over"),
    Field("withheld", Kind.COUNTS_BY_NAME, "how many frames the robot kept back, by reason"),
    Field("restricted", Kind.BOOL, "whether a restriction is on it"),
)

_STANDING = (
    Field(
        "restriction",
        Kind.OBJECT,
        "what restricts it",
        null="if nothing does",
        fields=(
            Field("ground", Kind.TEXT, "why: `accuracy`, `unlawful`, `legal-claim` or `objection`"),
            Field("whole_visit", Kind.BOOL, "whether it is on every record"),
            Field("kept_until_ms", Kind.TIME_MS, "until when it is kept beyond its time", null="if it is not"),
        ),
    ),
    Field("objected_purposes", Kind.TEXTS, "purposes for which nothing of it is released"),
    Field("corrections", Kind.COUNT, "how many corrections stand beside it"),
    Field("breach_id", Kind.HEX, "the breach for which it is in quarantine", null="if it is in none"),
    Field(
        "breach_end",
        Kind.OBJECT,
        "how an officer ended that breach",
        null="if none did",
        fields=(
            Field("breach_id", Kind.HEX, "the breach"),
            Field("outcome", Kind.TEXT, "`erased` or `released`"),
            Field("reason", Kind.TEXT, "the reason's code"),
            Field("time_ms", Kind.TIME_MS, "when"),
        ),
    ),
    Field(
        "erased_by_officers",
        Kind.ROWS,
        "what two officers together had erased of it",
        fields=(
            Field("proposal_id", Kind.HEX, "their proposal"),
            Field("reason", Kind.TEXT, "the reason's code"),
            Field("records", Kind.COUNT, "how many records"),
            Field("time_ms", Kind.TIME_MS, "when"),
        ),
    ),
)

_FORMER_WORDS = (
    Field("taken_visits", Kind.HEXES, "visits that obey somebody else's key"),
    Field("exposed_visits", Kind.HEXES, "visits of which a key from former words still decides"),
    Field("stuck_visits", Kind.HEXES, "visits that obey former words and can be given no other key any more"),
)

_TRANSFERRED = (
    Field("transferred", Kind.HEXES, "visits that have a new key now"),
    Field("taken_visits", Kind.HEXES, "visits that obey somebody else's key"),
    Field("stuck_visits", Kind.HEXES, "visits that can be given no other key any more"),
    Field("ended_shares", Kind.HEXES, "shares that this wallet had no note of, ended by this; see `--keep-shares`"),
)

NOTICE = (
    Field("organisation", Kind.TEXT, "whose words these are"),
    Field("version", Kind.COUNT, "the version in force; 0: nothing is published"),
    Field("hash", Kind.HEX, "the hash that stands on the chain", null="if nothing is published"),
    Field("published_at_ms", Kind.TIME_MS, "when it was published", null="if nothing is"),
    Field("consented_version", Kind.COUNT, "under which version she consented", null="if that is this one, or none"),
    Field("changes", Kind.TEXTS, "what changed since that version, a sentence each"),
    Field("lines", Kind.TEXTS, "the notice, a line each"),
)
"""What an organisation tells people, as `notices.Told.as_json` tells it."""

_RECEIPT = (
    Field(
        "receipt",
        Kind.OBJECT,
        "the consent receipt that was fetched",
        null="if it could not be had yet",
        fields=(
            Field("signed_by", Kind.TEXT, "the node that signed it"),
            Field("notice_version", Kind.COUNT, "the notice it is about", null="if none was published"),
        ),
    ),
    Field("receipt_error", Kind.TEXT, "the code of what was in its way", null="if the receipt is here"),
)

_CONSENT_WORD = (
    TXID,
    HEIGHT,
    Field("from_height", Kind.HEIGHT, "from which block on it holds"),
    Field("count", Kind.COUNT, "how many choices it changed"),
    Field("status", Kind.TEXT, "`given`, `refused` or `withdrawn`"),
    Field("purposes", Kind.TEXTS, "purposes' codes; none in a no: all"),
    Field("sensors", Kind.TEXTS, "sensors' codes; none in a no: all"),
    *SPOKEN_FOR,
)

_MADE = (
    CommandAnswer(("wallet new",), (_WALLET, _MEMBER)),
    CommandAnswer(("wallet restore",), (_WALLET, _MEMBER, _WORDS_CHECKED)),
    CommandAnswer(
        ("wallet rotate",),
        (Field("words_file", Kind.TEXT, "where the new words are", null="if none was named"), *_TRANSFERRED),
    ),
    CommandAnswer(("wallet transfer",), _TRANSFERRED),
    CommandAnswer(
        ("wallet leave",),
        (Field("height", Kind.HEIGHT, "the block in which it ended", null="if it had ended before"),),
    ),
    CommandAnswer(
        ("wallet keyring store",),
        (_WALLET, Field("weak_keyring", Kind.TEXT, "the keyring's name", null="unless it protects little")),
    ),
    CommandAnswer(("wallet keyring forget",), (_WALLET,)),
    CommandAnswer(
        ("wallet serve",),
        (
            Field("url", Kind.TEXT, "the page's address; alone it opens nothing", absent=_AT_ITS_END),
            Field("redirect_file", Kind.TEXT, "the file that opens the page, once", absent=_AT_ITS_END),
            Field("browser_opened", Kind.BOOL, "whether a browser was started", absent=_AT_ITS_END),
            Field(
                "unfinished",
                Kind.ROWS,
                "what was asked for last on the page and came to nothing",
                absent="when it begins",
                fields=(
                    Field("kind", Kind.TEXT, "`consent`, `share`, `revoke`, `erase`, `register` or `export`"),
                    Field(
                        "error",
                        Kind.OBJECT,
                        "why: `code`, `detail` and `next_step`",
                        null="if it was broken off, or its file was not saved",
                    ),
                ),
            ),
            Field(
                "not_begun",
                Kind.BOOL,
                "whether something was asked for last on the page that was not begun",
                absent="when it begins",
            ),
        ),
        not_ok="at its end, if something that was asked for last on the page came to nothing",
        lines="Printed once the page is there; the command then runs until it is stopped. "
        "A second object is printed when it ends only if something was left unfinished, or not begun; "
        "the exit code is 1 then.",
    ),
)

_PROBE = CommandAnswer(
    ("wallet probe",),
    (Field("refusals", Kind.TEXTS_BY_NAME, "by custodian and asker, the refusal's code, or `RELEASED`"),),
    lines="A command for demonstrations, which the list of commands leaves out.",
)

_CONSENT = (
    CommandAnswer(
        ("wallet register",),
        (
            Field("notice", Kind.OBJECT, "what the organisation that issued the card tells", fields=NOTICE),
            *(
                Field(each.name, each.kind, each.meaning, each.null, "if nothing was consented to", each.fields)
                for each in _RECEIPT
            ),
            Field("txid", Kind.HEX, "the registration; empty if this wallet had been registered before"),
            _MEMBER,
            Field("purposes", Kind.TEXTS, "what was consented to"),
        ),
    ),
    CommandAnswer(("wallet notice",), NOTICE),
    CommandAnswer(
        ("wallet consent give",),
        (
            *_CONSENT_WORD,
            Field("period_from_ms", Kind.TIME_MS, "not before", null="if no beginning was named"),
            Field("period_until_ms", Kind.TIME_MS, "not after", null="if no end was named"),
            Field("notice", Kind.OBJECT, "the notice", null="if this wallet had shown it before", fields=NOTICE),
            *_RECEIPT,
        ),
    ),
    CommandAnswer(("wallet consent refuse", "wallet consent withdraw"), (*_CONSENT_WORD, *_RECEIPT)),
    CommandAnswer(
        ("wallet consent list",),
        (
            Field("height", Kind.HEIGHT, "the block as of which it is proved"),
            Field(
                "choices",
                Kind.ROWS,
                "her last word on each purpose and sensor",
                fields=(
                    Field("purpose", Kind.TEXT, "the purpose's code"),
                    Field("sensor", Kind.TEXT, "the sensor's code"),
                    Field("holds_now", Kind.BOOL, "whether it allows recording at that block"),
                    Field("status", Kind.TEXT, "`given`, `refused` or `withdrawn`"),
                    Field("from_height", Kind.HEIGHT, "from which block on it holds"),
                    Field("since_ms", Kind.TIME_MS, "when it was said"),
                    Field("period_from_ms", Kind.TIME_MS, "not before", null="if there is no beginning"),
                    Field("period_until_ms", Kind.TIME_MS, "not after", null="if there is no end"),
                    Field("mandate_id", Kind.HEX, "under which mandate it was said", null="if she said it herself"),
                ),
            ),
        ),
    ),
    CommandAnswer(
        ("wallet consent receipts",),
        (
            Field(
                "receipts",
                Kind.ROWS,
                "each receipt as it was signed; its fields: [formats](formats.md#privacy-notice-and-consent-receipts-"
                "consensusrightsnoticespy-consent_receiptspy)",
            ),
            Field(
                "missing",
                Kind.ROWS,
                "words whose receipt could not be had",
                fields=(TXID, Field("code", Kind.TEXT, "why not: the error's code")),
            ),
            Field("file", Kind.TEXT, "what `--out` wrote", null="if nothing was written"),
        ),
    ),
)

_READING = (
    CommandAnswer(
        ("wallet records",),
        (
            Field("notice_changed_to", Kind.COUNT, "a notice's version that came since she consented", null="if none"),
            Field("mandate_id", Kind.HEX, "the mandate by which somebody acts for her, or is to", null="if none"),
            Field(
                "visits",
                Kind.ROWS,
                "each visit on this page",
                fields=(
                    VISIT,
                    Field("robot", Kind.HEX, "the robot's key"),
                    Field("robot_name", Kind.TEXT, "what its organisation calls it; empty if it has no name"),
                    Field("robot_place", Kind.TEXT, "where it is; empty if that was not said"),
                    Field("closed", Kind.BOOL, "whether the robot closed it"),
                    Field("missing_records", Kind.COUNT, "how many records the robot took and never brought"),
                    Field("erased_records", Kind.HEXES, "ids of records that are erased"),
                    Field("unreadable_records", Kind.HEXES, "ids of records that do not open"),
                    Field("needs_former_words", Kind.BOOL, "whether that is because former words are missing"),
                    Field("records", Kind.ROWS, "each record that is asked for", fields=_RECORD),
                    *_STANDING,
                ),
            ),
            *_FORMER_WORDS,
            Field("page", Kind.COUNT, "this page, from 1"),
            Field("pages", Kind.COUNT, "how many there are"),
            Field("matching_records", Kind.COUNT, "how many records are asked for, on all pages"),
            Field("all_records", Kind.COUNT, "how many there are"),
        ),
    ),
    CommandAnswer(
        ("wallet audit",),
        (
            Field(
                "entries",
                Kind.ROWS,
                "what happened, in the order of the chain",
                fields=(
                    VISIT,
                    Field("index", Kind.COUNT, "its number in the visit's audit, from 0"),
                    Field("record_id", Kind.HEX, "the record; empty if it is about several, or the visit"),
                    Field("records", Kind.HEXES, "ids of all records that it names"),
                    Field("kind", Kind.TEXT, "what happened, a code"),
                    TIME,
                    HEIGHT,
                    Field("detail", Kind.TEXT, "more of it, in a few English words; empty if the kind says it all"),
                ),
            ),
        ),
    ),
    CommandAnswer(
        ("wallet export",),
        (
            Field("file", Kind.TEXT, "the bundle"),
            Field("bytes", Kind.COUNT, "its size in bytes"),
            Field("is_complete", Kind.BOOL, "whether everything that was asked for is in it"),
            Field("visits", Kind.COUNT, "how many visits"),
            Field("records", Kind.COUNT, "how many records"),
            Field("pictures", Kind.COUNT, "how many pictures, labels and sounds"),
            Field("audit_entries", Kind.COUNT, "how many events"),
            Field("accesses", Kind.COUNT, "how many requests for pictures"),
            Field("erasures", Kind.COUNT, "how many requests for erasure"),
            Field("consent_receipts", Kind.COUNT, "how many words on consent after registering, with receipts"),
            Field("signed_consent_receipts", Kind.COUNT, "how many receipts that both sides signed"),
            Field("proved_until_height", Kind.HEIGHT, "the block as of which it is proved"),
            Field("genesis_id", Kind.HEX, "the genesis hash of its network"),
            Field(
                "problems",
                Kind.ROWS,
                "what could not be had",
                fields=(
                    Field("record_id", Kind.TEXT, "of which record; empty: of all"),
                    Field("code", Kind.TEXT, "the error's code"),
                    Field("sentence", Kind.TEXT, "why, in English"),
                ),
            ),
            Field("not_proved", Kind.TEXTS, "what the bundle leaves open, a sentence each"),
        ),
    ),
)

_KEPT = Field("kept_until_ms", Kind.TIME_MS, "until when it is kept beyond its time", null="if it is not")

_RIGHTS = (
    CommandAnswer(
        ("wallet restrict",),
        (
            Field("ground", Kind.TEXT, "why"),
            Field("restricted", Kind.ROWS, "each visit of which it was said", fields=(*_SAID, _KEPT)),
        ),
    ),
    CommandAnswer(("wallet lift",), (Field("lifted", Kind.ROWS, "each visit of which it was said", fields=_SAID),)),
    CommandAnswer(
        ("wallet object",),
        (
            Field("purposes", Kind.TEXTS, "purposes' codes"),
            Field("from_height", Kind.HEIGHT, "from which block on nothing is recorded for them"),
            Field("visits", Kind.ROWS, "each past visit that was told", fields=_SAID),
            *SPOKEN_FOR,
        ),
    ),
    CommandAnswer(
        ("wallet correct",),
        (
            Field("kind", Kind.TEXT, "`attribution` or `metadata`"),
            *_SAID,
            Field("number", Kind.COUNT, "its number at that visit, from 0"),
            Field("out", Kind.TEXT, "the file to hand on", null="without `--out`"),
        ),
    ),
    CommandAnswer(
        ("wallet wrong-person",),
        (
            *_SAID,
            Field("breach_id", Kind.HEX, "the breach that officers find"),
            Field("organisation", Kind.TEXT, "whose robot it was"),
            Field("due_ms", Kind.TIME_MS, "when the 72 hours are over"),
        ),
    ),
    CommandAnswer(
        ("wallet receipts",),
        (
            Field(
                "receipts",
                Kind.ROWS,
                "each receipt whose proof the wallet keeps and that holds, oldest first; no node was asked",
                fields=(
                    Field("txid", Kind.HEX, "the transaction; of an erasure its id"),
                    Field(
                        "kind",
                        Kind.TEXT,
                        "`erasure`, `registration`, `rotation`, `given`, `refused`, `withdrawn` or `other`",
                    ),
                    Field("height", Kind.HEIGHT, "its block"),
                    Field("time_ms", Kind.TIME_MS, "the block's time"),
                    Field("proved_height", Kind.HEIGHT, "the block that its last part was proved by"),
                    Field(
                        "confirmed",
                        Kind.ROWS,
                        "what custodians said of a complete erasure",
                        fields=(
                            Field("custodian", Kind.HEX, "its key"),
                            Field("destroyed_frames", Kind.COUNT, "how many pictures it destroyed"),
                            Field("time_ms", Kind.TIME_MS, "when"),
                        ),
                    ),
                ),
            ),
            Field(
                "problems",
                Kind.ROWS,
                "proofs that do not hold",
                fields=(Field("code", Kind.TEXT, "the error's code"), Field("detail", Kind.TEXT, "why")),
            ),
            Field("dropped", Kind.COUNT, "older proofs that were dropped: the file is bounded"),
        ),
    ),
    CommandAnswer(
        ("wallet erasures",),
        (
            Field(
                "erasures",
                Kind.ROWS,
                "each request, oldest first",
                fields=(
                    Field("erasure_id", Kind.HEX, "the request"),
                    VISIT,
                    Field("asked_at_ms", Kind.TIME_MS, "when it was asked for"),
                    Field("records", Kind.COUNT, "how many records"),
                    Field("frames", Kind.COUNTS, "indexes of the pictures, if only some of one record"),
                    Field("status", Kind.TEXT, "`requested` or `complete`"),
                    Field(
                        "custodians",
                        Kind.ROWS,
                        "what each custodian said",
                        fields=(
                            Field("name", Kind.TEXT, "its name and organisation"),
                            Field("confirmed_at_ms", Kind.TIME_MS, "when it confirmed", null="if it has not yet"),
                            Field("destroyed_frames", Kind.COUNT, "how many pictures it destroyed"),
                            Field("remains", Kind.TEXT, "what remains there, a code; empty until it confirmed"),
                            Field("remains_until_ms", Kind.TIME_MS, "until when; 0 until it confirmed"),
                            Field("overdue", Kind.BOOL, "whether it should have confirmed long ago"),
                        ),
                    ),
                ),
            ),
        ),
    ),
)

ANSWERS: tuple[CommandAnswer, ...] = (*_MADE, *_CONSENT, *_READING, *_RIGHTS, _PROBE)
"""What these commands answer."""
