"""A tag reader in a process of its own: llrpkit's emulator, which speaks the protocol as a real reader does.

The settings are one JSON object as the only argument: `port`, `tags` (hexadecimal EPC to its antennas), `reads_per_s`,
`clock_off_s` (how wrong the reader's clock is), `nonsense_after_s` (when it sends what is no LLRP), `storm_per_s` (reports
that come in messages of ten, so that the emulator is not what limits them).
"""

from __future__ import annotations

import asyncio
import itertools
import json
import sys
import time
from typing import Any

from llrpkit.emulator import LLRPEmulator
from llrpkit.emulator.core import EmulatedTag
from llrpkit.protocol import messages, params


async def serve(settings: dict[str, Any]) -> None:
    class Reader(LLRPEmulator):
        @staticmethod
        def _now_us() -> int:
            return int((time.time() + settings.get("clock_off_s", 0.0)) * 1_000_000)

        async def _report_loop(self) -> None:
            if "storm_per_s" not in settings:
                await super()._report_loop()
                return
            for number in itertools.count():
                await self._send(messages.RO_ACCESS_REPORT(tag_report_datas=[self.read(number + i) for i in range(10)]))
                if number % 10 == 0:
                    await asyncio.sleep(100 / settings["storm_per_s"])

        def read(self, number: int) -> params.TagReportData:
            tag, now = self.tags[number % len(self.tags)], self._now_us()
            return params.TagReportData(
                epc_parameter=params.EPC_96(epc=tag.epc),
                antenna_id=params.AntennaID(antenna_id=tag.antennas[number % len(tag.antennas)]),
                first_seen_timestamp_utc=params.FirstSeenTimestampUTC(microseconds=now),
                last_seen_timestamp_utc=params.LastSeenTimestampUTC(microseconds=now),
                tag_seen_count=params.TagSeenCount(tag_count=1),
            )

    tags = [EmulatedTag(bytes.fromhex(epc), antennas=tuple(places)) for epc, places in settings["tags"].items()]
    reader = Reader(port=settings["port"], tags=tags, reads_per_sec=settings.get("reads_per_s", 20))
    async with reader:
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        if "nonsense_after_s" in settings:
            while reader._report_task is None:  # noqa: ASYNC110 - the emulator tells nobody
                await asyncio.sleep(0.05)
            await asyncio.sleep(settings["nonsense_after_s"])
            assert reader._writer is not None
            reader._writer.write(b"GET / HTTP/1.1\r\n" * 4)
        await asyncio.sleep(3_600)


if __name__ == "__main__":
    asyncio.run(serve(json.loads(sys.argv[1])))
