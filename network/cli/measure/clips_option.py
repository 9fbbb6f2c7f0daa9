"""`--clips`: a measurement's custodians keep their clips apart from their stores."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from clients.sdk.terminal.terminal import EXISTING_FILE
from node.clips_place import REGION_DEFAULT


def with_clips(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command `apart`: a `ClipsApart`, or None."""

    @click.option("--clips", help="Keep clips apart: folder, or s3://BUCKET/PREFIX (a bucket that is there).")
    @click.option("--clips-endpoint", default="", help="The S3 server's URL. Default: AWS.")
    @click.option("--clips-region", default=REGION_DEFAULT, show_default=True, help="The S3 server's region.")
    @click.option("--clips-ca", type=EXISTING_FILE, help="Certificates that the S3 server's is checked by.")
    @click.option("--clips-credentials", type=EXISTING_FILE, help="A file of credentials, as the AWS tools read it.")
    @wraps(command)
    def given(
        *args: Any,
        clips: str | None,
        clips_endpoint: str,
        clips_region: str,
        clips_ca: Path | None,
        clips_credentials: Path | None,
        **others: Any,
    ) -> None:
        from network.bench.clips_apart import ClipsApart  # noqa: PLC0415 - only when it is needed

        if clips is None:
            command(*args, apart=None, **others)
            return
        ca, credentials = (None if path is None else path.resolve() for path in (clips_ca, clips_credentials))
        apart = ClipsApart(clips, clips_endpoint, clips_region, ca, credentials)
        apart.place_of("custodian", Path.cwd())  # what is wrong with it is told before anything starts
        command(*args, apart=apart, **others)

    return given
