"""Tells a person what she gives away by acting on several visits at once."""

from __future__ import annotations

import click

from clients.wallet.present.translations import text


def tell_linked(visit_count: int) -> None:
    """Say on standard error that so many visits, spoken for one after the other, can be told to be one person's."""
    if visit_count > 1:
        click.echo(text("linked.acting", number=visit_count), err=True)


def tell_linked_moves(visit_count: int, *, with_member: bool) -> None:
    """Say on standard error what giving visits new keys all at once tells, and how to do it otherwise.

    `with_member`: the membership has just got its new key, so that the visits can be told to be that member's.
    """
    if not visit_count or (visit_count == 1 and not with_member):
        return
    key = "linked.moving_member" if with_member else "linked.moving"
    told = text(key, count=visit_count, number=visit_count)
    click.echo(f"{told} {text('linked.otherwise')}", err=True)
