"""The report of a hospital's year: what happened, what held, and pictures of sizes and costs by month."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from network.lab.year.figures import COSTS, HospitalYearAnswer, YearEnd, YearMonth
from network.report_page import Section, build_report, drawing, quiet, table, text, tiles

MB = 1_000_000
WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 680, 230, 70, 42, 14
_COLOURS = ("#1f5f8b", "#b4540a", "#1b6b3a", "#7a3e8f", "#5d6470", "#8a6d00")
_PART_OF_COLUMN = 0.7
_WHOLE_FROM = 100


def build_page(answer: HospitalYearAnswer) -> str:
    months = answer.months
    sections = [
        Section("What happened", _happened(answer)),
        Section("Sizes", _sizes(months)),
        Section("What a day costs", _costs(months), new_sheet=True),
        Section("After the last day", _end(answer.end)),
    ]
    if answer.failures:
        rows = [[text(each)] for each in answer.failures]
        sections.insert(0, Section("What did not go as it should", table("Failures", ["What"], rows)))
    held = not answer.failures
    verdict = "Everything held, at the end of every month." if held else "Not everything held."
    lead = f"<p><strong>{verdict}</strong></p><p>{text(_told(answer))}</p>"
    return build_report("A year in a day", lead, sections, lead_is_good=held)


def _told(answer: HospitalYearAnswer) -> str:
    asked = ("days", "members", "robots", "custodians")
    size = ", ".join(f"{answer.conditions[name]} {name}" for name in asked)
    return (
        f"{size}, seed {answer.seed}; newest block {answer.head[:16]}. {answer.days_a_minute:g} days a minute without the "
        f"checks, on {answer.conditions['cores']} cores with a load of {answer.conditions['load']}."
    )


def _happened(answer: HospitalYearAnswer) -> str:
    last = answer.months[-1]
    shown = [(f"{last.visits:,}", "visits"), (f"{last.records:,}", "records"), (f"{last.erased:,}", "of them gone")]
    shown += [
        (f"{last.transactions:,}", "transactions"),
        (f"{last.blocks:,}", "blocks"),
        (f"{last.members:,}", "members"),
    ]
    rows = [[text(what), f"{count:,}"] for what, count in answer.happened.items()]
    return tiles(shown) + table("How often what happened", ["What", "Times"], rows)


def _columns(name: str, unit: str, series: Mapping[str, Sequence[float]], labels: Sequence[str]) -> str:
    """A column for each month, in parts one upon the other."""
    highest = max((sum(parts) for parts in zip(*series.values(), strict=True)), default=0) or 1
    wide = (WIDTH - LEFT) / max(1, len(labels))
    scale = (HEIGHT - TOP - BOTTOM) / highest
    floor = HEIGHT - BOTTOM
    top = f"{highest:,.0f}" if highest >= _WHOLE_FROM else f"{highest:.2f}"
    drawn = [f'<text x="{LEFT - 8}" y="{TOP + 4}" text-anchor="end">{top} {text(unit)}</text>']
    drawn.append(f'<text x="{LEFT - 8}" y="{floor}" text-anchor="end">0</text>')
    drawn.append(f'<path d="M{LEFT} {TOP}V{floor}H{WIDTH}" fill="none" stroke="#44546a"/>')
    for place, label in enumerate(labels):
        x, y = LEFT + wide * (place + (1 - _PART_OF_COLUMN) / 2), float(floor)
        for colour, values in zip(_COLOURS, series.values(), strict=False):
            tall = values[place] * scale
            y -= tall
            size = f'width="{wide * _PART_OF_COLUMN:.1f}" height="{tall:.1f}"'
            drawn.append(f'<rect x="{x:.1f}" y="{y:.1f}" {size} fill="{colour}"/>')
        middle = x + wide * _PART_OF_COLUMN / 2
        drawn.append(f'<text x="{middle:.1f}" y="{floor + 15}" text-anchor="middle">{text(label)}</text>')
    step = WIDTH / len(series)
    for place, what in enumerate(series):
        x = place * step
        drawn.append(f'<rect x="{x:.0f}" y="{HEIGHT - 12}" width="10" height="10" fill="{_COLOURS[place]}"/>')
        drawn.append(f'<text x="{x + 14:.0f}" y="{HEIGHT - 3}">{text(what)}</text>')
    head = f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" font-size="11" font-family="sans-serif">'
    svg = f"{head}{''.join(drawn)}</svg>"
    return drawing(svg, name=name, alternative=f"{name}, a column for each month; the table below says the same")


def _labels(months: Sequence[YearMonth]) -> list[str]:
    return [f"day {month.days}" for month in months]


def _sizes(months: Sequence[YearMonth]) -> str:
    in_ledger = {"one node's ledger": [month.ledger_bytes / MB for month in months]}
    in_custody = {
        "one custodian's database": [month.custody_bytes / MB for month in months],
        "its erase keys": [month.erase_key_bytes / MB for month in months],
    }
    records = {
        "kept": [float(month.kept) for month in months],
        "erased or expired": [float(month.erased) for month in months],
    }
    rows = [
        [
            text(label),
            *(f"{count:,}" for count in (month.blocks, month.transactions, month.records, month.kept)),
            *(f"{count:,}" for count in (month.state_entries, month.erase_keys)),
            *(f"{size / MB:,.1f}" for size in (month.ledger_bytes, month.custody_bytes, month.erase_key_bytes)),
        ]
        for label, month in zip(_labels(months), months, strict=True)
    ]
    headings = ["Until", "Blocks", "Transactions", "Records", "Kept", "State", "Keys", "Ledger", "Custody", "Key file"]
    labels = _labels(months)
    return (
        _columns("Ledger (MB)", "MB", in_ledger, labels)
        + _columns("Custody (MB)", "MB", in_custody, labels)
        + _columns("Records", "", records, labels)
        + table("At the end of each month; sizes in MB", headings, rows)
        + quiet("Nothing of the ledger is pruned. Custody and keys are one custodian's; the others have as much.")
    )


def _costs(months: Sequence[YearMonth]) -> str:
    series = {what: [month.seconds_a_day[what] for month in months] for what in COSTS}
    labels = _labels(months)
    rows = [
        [
            text(label),
            *(f"{month.seconds_a_day[what]:,.3f}" for what in COSTS),
            f"{month.day_s:,.2f}",
            f"{month.day_cpu_s:,.2f}",
            f"{month.checks_s:,.1f}",
        ]
        for label, month in zip(labels, months, strict=True)
    ]
    return (
        _columns("Seconds a day", "s", series, labels)
        + table("Seconds of a day, by month", ["Until", *COSTS, "All", "CPU", "Checks"], rows)
        + quiet(
            "Execution and commit are of one node, the rest until the last custodian was done. What is left to “all” is "
            "robots and wallets: sealing, signing, downloads. “Checks” are those at the end of the month, once."
        )
    )


def _end(end: YearEnd) -> str:
    rows = [
        ["Members' audits", f"{end.audits:,}", f"{end.audit_entries:,} entries proved, {end.audit_s:g} s a member"],
        ["Records hunted for", f"{end.hunted_records:,}", f"{end.hunted_bytes / MB:,.0f} MB searched"],
        ["A node from a snapshot", f"{end.snapshot_bytes / MB:,.1f} MB", f"{end.snapshot_start_s:g} s"],
        [
            "A node from a backup",
            f"{end.backup_bytes / MB:,.1f} MB",
            f"{end.restore_s:g} s, {end.clips_fetched:,} clips fetched from the other custodians",
        ],
    ]
    return table("What was looked at after the last day", ["What", "How much", ""], rows, numbers_from=3)
