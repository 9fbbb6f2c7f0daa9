"""Wallet `--json` fields: sharing, inbox, erasure, guardians."""

from __future__ import annotations

from clients.sdk.terminal.json_fields import CommandAnswer, Field, Kind
from clients.wallet.present.json_fields import CHECKED, HEIGHT, MISSING_ROOMS, TIME, VISIT

_GRANT = Field("grant_id", Kind.HEX, "the grant")
_PURPOSE = Field("purpose", Kind.TEXT, "the purpose's code")
_UNTIL = Field("until_ms", Kind.TIME_MS, "when it ends")
_SHARED_AT = Field("shared_at_ms", Kind.TIME_MS, "when it was shared")

_SHARE = (
    _GRANT,
    VISIT,
    Field("records", Kind.HEXES, "ids of the records that are shared"),
    Field("handle", Kind.HEX, "the other's handle", null="if this wallet does not remember it"),
    Field("name", Kind.TEXT, "what this wallet calls the other", null="if nothing"),
    _PURPOSE,
    _SHARED_AT,
    _UNTIL,
    Field("status", Kind.TEXT, "`open`, `over` (its time) or `revoked`"),
    Field(
        "looks",
        Kind.ROWS,
        "each time that the other asked for pictures",
        fields=(
            Field("time_ms", Kind.TIME_MS, "when"),
            Field("records", Kind.COUNT, "for how many records"),
            Field("custodians_released", Kind.COUNT, "how many custodians then stood ready"),
        ),
    ),
    Field("cut", Kind.HEXES, "ids of records of which single pictures were erased since: they are shared no more"),
    Field("erased", Kind.HEXES, "ids of records that were erased whole since: they are shared no more"),
    Field("confirmed_deleted", Kind.HEXES, "ids of records whose copies the other says are deleted"),
)
"""A grant of one's own, as `sharing_commands.share_json` tells it."""

_ERASING = (
    CommandAnswer(
        ("wallet erase",),
        (
            Field(
                "error",
                Kind.OBJECT,
                "`ERASURE_NOT_CONFIRMED`, as in a refusal",
                absent="unless `--wait` waited in vain",
                fields=(
                    Field("code", Kind.TEXT, "the error's code"),
                    Field("detail", Kind.TEXT, "what happened"),
                    Field("next_step", Kind.TEXT, "what to do"),
                ),
            ),
            Field(
                "erasures",
                Kind.ROWS,
                "each request that was made: one for each visit, or for 64 records of it",
                fields=(
                    Field("erasure_id", Kind.HEX, "the request"),
                    Field("status", Kind.TEXT, "`requested` or `complete`"),
                    Field("custodians", Kind.HEXES, "keys of the custodians that are to destroy it"),
                    Field("confirmed", Kind.HEXES, "keys of those that have confirmed"),
                ),
            ),
            Field(
                "left_out_numbers", Kind.COUNTS, "places, from 1, of pictures that were named and are erased already"
            ),
            Field("recipients", Kind.ROWS, "each grant under which somebody had received it", fields=_SHARE),
        ),
        not_ok="if `--wait` waited in vain: it is asked for, and not every custodian has confirmed it",
    ),
)

_OWNER = (
    CommandAnswer(
        ("wallet share",),
        (
            Field("handle", Kind.HEX, "the other's handle"),
            Field("role", Kind.TEXT, "the other's role"),
            _PURPOSE,
            Field(
                "shared",
                Kind.ROWS,
                "each grant that was made: one for 64 records",
                fields=(
                    _GRANT,
                    VISIT,
                    Field("records", Kind.HEXES, "ids of the records that are shared"),
                    Field("left_out", Kind.HEXES, "ids of records that could not be"),
                    _UNTIL,
                    Field("pictures", Kind.COUNT, "how many pictures can be opened"),
                    Field("custodians", Kind.TEXTS, "names of the custodians that hold the parts of the key"),
                    Field("custodians_away", Kind.TEXTS, "names of those that could not be reached"),
                ),
            ),
        ),
    ),
    CommandAnswer(("wallet shares",), (Field("shares", Kind.ROWS, "each grant", fields=_SHARE),)),
    CommandAnswer(
        ("wallet revoke",),
        (
            _GRANT,
            Field("txid", Kind.HEX, "the transaction", null="if it had been revoked before"),
            Field("looks", Kind.COUNT, "how often the other had asked for pictures"),
            Field("already_ended", Kind.BOOL, "whether it had been revoked before"),
        ),
    ),
    CommandAnswer(
        ("wallet handle",),
        (
            Field("handle", Kind.HEX, "one's own handle"),
            Field("short", Kind.TEXT, "the same in short, with a checksum"),
            Field("role", Kind.TEXT, "one's own role"),
        ),
    ),
)

_RECEIVED = (
    _GRANT,
    VISIT,
    Field("records", Kind.HEXES, "ids of the records that were shared"),
    _PURPOSE,
    _SHARED_AT,
    _UNTIL,
    Field("open", Kind.BOOL, "whether it can be looked at by its terms"),
    Field("looked", Kind.BOOL, "whether one ever asked for its pictures"),
    Field("to_look", Kind.HEXES, "ids of records that can still be looked at"),
    Field(
        "notices",
        Kind.ROWS,
        "what became of its records",
        fields=(
            Field("record_id", Kind.HEX, "the record"),
            Field(
                "kind",
                Kind.TEXT,
                "`erased`, `pictures-erased`, `corrected`, `restricted`, `denied`, `revoked` or `ended`",
            ),
            Field("confirmed", Kind.BOOL, "whether one has said that the copies are deleted"),
        ),
    ),
    Field("to_confirm", Kind.HEXES, "ids of records of which that is still to be said"),
    Field("copies", Kind.TEXTS, "folders on this machine that still hold pictures"),
)

_GRANTEE = (
    CommandAnswer(
        ("wallet inbox",),
        (
            Field("received", Kind.ROWS, "each grant that one received", fields=_RECEIVED),
            Field(
                "unread",
                Kind.ROWS,
                "each grant that could not be read",
                fields=(
                    _GRANT,
                    Field("code", Kind.TEXT, "the error's code"),
                    Field("detail", Kind.TEXT, "why, in English"),
                ),
            ),
            Field(
                "alarms",
                Kind.ROWS,
                "each visit of one's own of which something is missing or does not open",
                fields=(
                    VISIT,
                    Field("missing_records", Kind.COUNT, "how many records never came"),
                    Field("unreadable_records", Kind.HEXES, "ids of records that do not open"),
                ),
            ),
            Field("reads_new", Kind.BOOL, "whether new grants are looked for: false if the membership ended"),
            Field(
                "looks",
                Kind.ROWS,
                "each time that somebody looked at one's own records by a share, oldest first",
                fields=(
                    VISIT,
                    _GRANT,
                    Field("records", Kind.COUNT, "at how many records"),
                    _PURPOSE,
                    TIME,
                    HEIGHT,
                ),
            ),
            Field("changed_records", Kind.HEXES, "ids of one's own records that were found changed"),
        ),
    ),
    CommandAnswer(
        ("wallet look",),
        (
            Field(
                "records",
                Kind.ROWS,
                "each record that was fetched",
                fields=(
                    Field("record_id", Kind.HEX, "the record"),
                    Field("custodians", Kind.TEXTS, "names of the custodians that released it"),
                    Field(
                        "frames",
                        Kind.ROWS,
                        "each picture, label or sound",
                        fields=(
                            Field("number", Kind.COUNT, "its place in the record, from 1"),
                            Field("status", Kind.TEXT, "`ok`, `corrupted`, `erased` or `notice`"),
                        ),
                    ),
                ),
            ),
            Field("restricted", Kind.HEXES, "ids of records that are left out because their owner restricted them"),
            Field("out", Kind.TEXT, "the folder of the pictures"),
            Field("earlier", Kind.TEXTS, "files of earlier looks that are still there, and not of this one"),
            MISSING_ROOMS,
        ),
    ),
    CommandAnswer(
        ("wallet confirm-deleted",),
        (
            Field("records", Kind.HEXES, "ids of records of which it was said"),
            Field("deleted", Kind.TEXTS, "folders that were deleted"),
            Field("kept", Kind.TEXTS, "files in them that `look` did not write, and that stay"),
        ),
    ),
)

_IDENTIFIER = Field("identifier", Kind.COUNT, "the number that all shares of a set bear")
_SET = (
    _IDENTIFIER,
    Field("made_at_ms", Kind.TIME_MS, "when it was made; 0: not by this wallet, which came from it"),
    Field("threshold", Kind.COUNT, "how many guardians are needed"),
    Field("guardians", Kind.TEXTS, "their names"),
    Field("handed_over", Kind.COUNT, "how many of them had their words when it ended"),
    Field("words_in_force", Kind.BOOL, "whether it brings the present words back"),
)
_SHEET = Field("sheet", Kind.COUNT, "the sheet's number, from 1")

_GUARDIANS = (
    CommandAnswer(
        ("wallet guardians", "wallet guardians list"),
        (Field("sets", Kind.ROWS, "each set of shares", fields=_SET),),
    ),
    CommandAnswer(
        ("wallet guardians split",),
        (*_SET, Field("sheets", Kind.TEXTS, "the sheets that were written")),
    ),
    CommandAnswer(
        ("wallet guardians check",),
        (_IDENTIFIER, _SHEET, Field("threshold", Kind.COUNT, "how many guardians are needed")),
    ),
    CommandAnswer(
        ("wallet guardians recover",),
        (
            Field("wallet", Kind.TEXT, "the wallet's file", absent="with `--words-only`"),
            Field("member", Kind.HEX, "the member key", absent="with `--words-only`"),
            Field("words_checked", Kind.BOOL, CHECKED, absent="with `--words-only`"),
            Field(
                "standing",
                Kind.TEXT,
                "what the network says of the words: `member`, `nobody` or `not_asked`",
                absent="with `--words-only`",
            ),
            Field("words_file", Kind.TEXT, "where the words are", null="without `--words-file`"),
            Field("left_out", Kind.ROWS, "shares that did not fit", fields=(_IDENTIFIER, _SHEET)),
        ),
    ),
)

ANSWERS: tuple[CommandAnswer, ...] = (*_ERASING, *_OWNER, *_GRANTEE, *_GUARDIANS)
"""What these commands answer."""
