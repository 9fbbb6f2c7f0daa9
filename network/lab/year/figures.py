"""What a year of a hospital comes to: sizes and costs by month, and what was checked."""

from __future__ import annotations

from typing import Annotated, Any

from clients.sdk.terminal.json_answers import Answer, Count, Hex, Seconds, doc

COSTS = ("execution", "commit", "upload", "block without erasure", "erasure", "expiry")
"""What a day's seconds went into, besides robots, wallets and checks."""


class YearMonth(Answer, frozen=True, kw_only=True):
    """The hospital at the end of a month (of 30 days; the last may be shorter), and what that month cost."""

    days: Annotated[Count, doc("How many days are over")]
    blocks: Annotated[Count, doc("Blocks so far, with genesis")]
    transactions: Annotated[Count, doc("Transactions so far")]
    members: Annotated[Count, doc("Active members: people, doctors, officers and robots")]
    visits: Annotated[Count, doc("Visits so far")]
    records: Annotated[Count, doc("Records so far")]
    kept: Annotated[Count, doc("Records that every custodian keeps")]
    erased: Annotated[Count, doc("Records that are gone, by erasure or by expiry")]
    state_entries: Annotated[Count, doc("Entries of the chain's state")]
    ledger_bytes: Annotated[Count, doc("Bytes of one node's ledger, of which nothing is pruned")]
    custody_bytes: Annotated[Count, doc("Bytes of one custodian's database")]
    erase_key_bytes: Annotated[Count, doc("Bytes of one custodian's erase-key file")]
    erase_keys: Annotated[Count, doc("Erase keys that are held")]
    seconds_a_day: Annotated[
        dict[str, Seconds],
        doc("By what a day's seconds went into, in this month; custody: until the last custodian was done"),
    ]
    day_s: Annotated[Seconds, doc("Of one day of this month altogether, without the checks at its end")]
    day_cpu_s: Annotated[Seconds, doc("The same in CPU time, which other work on the machine does not lengthen")]
    checks_s: Annotated[Seconds, doc("Of the checks at its end")]


class YearEnd(Answer, frozen=True, kw_only=True):
    """What was looked at after the last day."""

    audits: Annotated[Count, doc("Members whose wallets audited all their visits")]
    audit_entries: Annotated[Count, doc("Entries of these audits, each proved")]
    audit_s: Annotated[Seconds, doc("Seconds of one member's audit, on average")]
    hunted_records: Annotated[Count, doc("Erased and expired records of which remains were searched for")]
    hunted_bytes: Annotated[Count, doc("Bytes that were searched")]
    snapshot_bytes: Annotated[Count, doc("Bytes of the snapshot from which a node was started")]
    snapshot_start_s: Annotated[Seconds, doc("Seconds from there to the newest block")]
    backup_bytes: Annotated[Count, doc("Bytes of the backup from which a node was restored")]
    restore_s: Annotated[Seconds, doc("Seconds from there to the newest block, custody with it")]
    clips_fetched: Annotated[Count, doc("Clips that the restored custodian fetched from the others")]


class HospitalYearAnswer(Answer, frozen=True, kw_only=True):
    """A hospital's year. `ok` is false if something did not go as it should."""

    failures: Annotated[list[str], doc("What did not go as it should, a sentence each")]
    seed: Annotated[int, doc("The seed: the same one, with the same options, makes the same chain")]
    head: Annotated[Hex, doc("The id of the newest block")]
    happened: Annotated[dict[str, Count], doc("How often what happened")]
    months: Annotated[list[YearMonth], doc("Month by month")]
    end: Annotated[YearEnd, doc("What was looked at after the last day")]
    days_a_minute: Annotated[float, doc("Days a minute, without the checks")]
    report: Annotated[str, doc("The report's file")]
    conditions: Annotated[dict[str, Any], doc("What it was measured under: cores, load, versions")]
