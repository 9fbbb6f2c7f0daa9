"""`--on`: a Dask cluster does the work of a measurement."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import click


def with_cluster(count_name: str = "") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command `--on`, refused beside its number of processes here, if it takes one."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @click.option("--on", default="", metavar="ADDRESS", help="A Dask scheduler, tls://HOST:PORT, to work there.")
        @wraps(command)
        def checked(*args: Any, on: str, **given: Any) -> None:
            if on:
                if count_name and given[count_name]:
                    raise click.UsageError(f"--on says where the work is done, --{count_name} how many do it here.")
                _check(on)
            command(*args, on=on, **given)

        return checked

    return decorate


def _check(address: str) -> None:
    from network.bench.cluster import check_address  # noqa: PLC0415 - only when it is needed

    try:
        check_address(address)
    except ValueError as error:
        raise click.BadParameter(f"{error}.", param_hint="--on") from None
