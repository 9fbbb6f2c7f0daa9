"""Notices, choices and receipts of consent, in words and as answers."""

from __future__ import annotations

from clients.wallet.answers.consent_answers import ConsentChoice, FetchedReceipt, NoticeAnswer
from clients.wallet.answers.mandate_answers import SpokenFor
from clients.wallet.consent.consent_by_mandate import RepresentedPerson
from clients.wallet.consent.consent_choices import Choice
from clients.wallet.consent.notice_reading import NoticeView
from clients.wallet.consent.receipt_fetching import ReceiptOutcome
from clients.wallet.presentation.translations import describe_error, language_in_use, section, text
from consensus.rights.notices import notice_lines


def notice_text(notice_view: NoticeView) -> list[str]:
    if notice_view.published is None:
        return [text("notice.none_published", organisation=notice_view.organisation)]
    head = text("notice.head", organisation=notice_view.organisation, version=notice_view.version)
    return [head, *(f"  {line}" for line in notice_words(notice_view, language_in_use()))]


def notice_words(notice_view: NoticeView, language: str) -> list[str]:
    """The published text with localised headings."""
    if notice_view.published is None:
        return []
    labels = {key: str(label) for key, label in section("notice.line", language).items()}
    whose = text("notice.own_words", language=language, organisation=notice_view.organisation)
    return [*notice_lines(notice_view.published.notice, labels), whose]


def notice_answer(notice_view: NoticeView) -> NoticeAnswer:
    row = None if notice_view.published is None else notice_view.published.row
    return NoticeAnswer(
        organisation=notice_view.organisation,
        version=notice_view.version,
        hash=None if row is None else row.digest.hex(),
        published_at_ms=None if row is None else row.time_ms,
        consented_version=None if notice_view.before is None else notice_view.before.version,
        changes=list(notice_view.changes),
        lines=[] if notice_view.published is None else notice_lines(notice_view.published.notice),
    )


def fetched_receipt(outcome: ReceiptOutcome) -> FetchedReceipt | None:
    if outcome.receipt is None:
        return None
    published = outcome.receipt.published
    version = None if published is None else published.row.version
    return FetchedReceipt(signed_by=outcome.receipt.node, notice_version=version)


def receipt_line(outcome: ReceiptOutcome) -> str:
    if outcome.receipt is None:
        why = describe_error(outcome.refusal)[0] if outcome.refusal is not None else ""
        return text("register.receipt_late", why=why)
    published, organisation = outcome.receipt.published, outcome.receipt.organisation
    if published is None:
        return text("register.receipt_unpublished", organisation=organisation)
    return text("register.receipt", organisation=organisation, version=published.row.version)


def spoken_for(person: RepresentedPerson | None) -> SpokenFor:
    if person is None:
        return SpokenFor(for_=None, mandate_id=None)
    return SpokenFor(for_=person.handle.hex(), mandate_id=person.mandate.mandate_id.hex())


def choice_answer(choice: Choice) -> ConsentChoice:
    last = choice.last
    return ConsentChoice(
        purpose=choice.purpose,
        sensor=choice.sensor,
        holds_now=choice.holds,
        status=last.status,
        from_height=last.height,
        since_ms=last.since_ms,
        period_from_ms=last.from_ms or None,
        period_until_ms=last.until_ms or None,
        mandate_id=last.mandate.hex() or None,
    )
