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
