"""Tells a person what she gives away by acting on several visits at once. Must never name a visit, nor stop her."""

from __future__ import annotations

import click


def tell_linked(visit_count: int) -> None:
    """Say on standard error that so many visits, spoken for one after the other, can be told to be one person's."""
    if visit_count > 1:
        click.echo(
            f"This speaks for {visit_count} of your visits, one right after the other: whoever reads the ledger can"
            " tell, for ever, that they are one person's. If you mind, name records of one visit at a time, hours apart.",
            err=True,
        )


def tell_linked_moves(visit_count: int, *, with_member: bool) -> None:
    """Say on standard error what giving visits new keys all at once tells, and how to do it otherwise.

    `with_member`: the membership has just got its new key, so that the visits can be told to be that member's.
    """
    if not visit_count or (visit_count == 1 and not with_member):
        return
    what = "1 of your visits gets" if visit_count == 1 else f"{visit_count} of your visits get"
    whose = "whose they are" if with_member else "that they are one person's"
    whose = whose.replace("they are", "it is") if visit_count == 1 else whose
    click.echo(
        f"{what} a new key at once: whoever reads the ledger can tell, for ever, {whose}. Without --now each is moved at a"
        " moment that chance decides, within ten minutes or what --over-minutes says; until then a thief can still see it.",
        err=True,
    )
