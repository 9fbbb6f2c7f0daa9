"""Warnings that acting on several visits links them."""

from __future__ import annotations

import click

from clients.wallet.presentation.translations import text


def print_linking_notice(visit_count: int) -> None:
    if visit_count > 1:
        click.echo(text("linked.acting", number=visit_count), err=True)


def print_linked_moves(visit_count: int, *, with_member: bool) -> None:
    """Of visits rotated together; `with_member`: with the member too."""
    if not visit_count or (visit_count == 1 and not with_member):
        return
    key = "linked.moving_member" if with_member else "linked.moving"
    notice = text(key, count=visit_count, number=visit_count)
    click.echo(f"{notice} {text('linked.otherwise')}", err=True)
