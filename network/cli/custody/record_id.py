"""A record's id as an argument of a command."""

from __future__ import annotations

import click

from consensus.records.envelopes import RECORD_ID_BYTES


class _RecordId(click.ParamType[bytes]):
    name = "record"

    def convert(self, value: str | bytes, param: click.Parameter | None, ctx: click.Context | None) -> bytes:
        if isinstance(value, bytes):
            return value
        try:
            record_id = bytes.fromhex(value)
        except ValueError:
            record_id = b""
        if len(record_id) != RECORD_ID_BYTES:
            self.fail(
                f"{value!r} is no record id: {2 * RECORD_ID_BYTES} hexadecimal digits, as `wallet records` shows them.",
                param,
                ctx,
            )
        return record_id


RECORD_ID = _RecordId()
