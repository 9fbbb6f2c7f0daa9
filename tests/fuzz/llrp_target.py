"""The bytes of a tag reader, into the library's decoder and into sightings."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from random import Random

from llrpkit.client import MAX_MESSAGE_BYTES, LLRPClient
from llrpkit.constants import MESSAGE_HEADER_LEN
from llrpkit.exceptions import MessageDecodeError
from llrpkit.protocol import decode_message, messages, params

from clients.robot.sensing.sensor_events import RefusedMessage, Sighting
from clients.robot.sources.live.llrp import _Library, _Link, _Opening
from clients.robot.sources.messages.field_map import EPC_MAX_CHARS
from clients.robot.sources.messages.topics import LlrpReader
from tests.fuzz.target import FlipBytes, Target


class _FeedListener:
    """Hears what becomes of a reader's reports."""

    def __init__(self) -> None:
        self.heard: list[Sighting | RefusedMessage] = []

    def sight(self, sighting: Sighting) -> None:
        self.heard.append(sighting)

    def refuse(self, refused: RefusedMessage) -> None:
        self.heard.append(refused)


def open_llrp() -> Target:
    """The bytes of a tag reader, cut into messages as the library's client does, into sightings."""
    library = _Library()
    loop = asyncio.new_event_loop()

    def run(data: bytes) -> None:
        loop.run_until_complete(hear(data))

    async def hear(data: bytes) -> None:
        ear = _FeedListener()
        link = _Link(library, LlrpReader("127.0.0.1", front=(1,)), ear, _Opening(1))  # type: ignore[arg-type]
        client = LLRPClient("127.0.0.1")
        try:
            for message in _messages(data):
                client._dispatch(decode_message(message))
        except MessageDecodeError:
            pass
        while not client.reports.empty():
            link._take(client.reports.get_nowait())
        link._tell(link._readings.flush())
        for one in ear.heard:
            assert isinstance(one, RefusedMessage) or 0 < len(one.uid) <= EPC_MAX_CHARS

    return Target("llrp", _llrp_seeds(), run, _mutate_llrp, 16 * 1024, loop.close)


def _messages(data: bytes) -> Iterator[bytes]:
    while len(data) >= MESSAGE_HEADER_LEN:
        length = int.from_bytes(data[2:6], "big")
        if not MESSAGE_HEADER_LEN <= length <= min(MAX_MESSAGE_BYTES, len(data)):
            return
        yield data[:length]
        data = data[length:]


def _mutate_llrp(data: bytes, random: Random, flip: FlipBytes) -> bytes:
    """Change the body of a message and say how long it is now."""
    body = flip(data[MESSAGE_HEADER_LEN:], random)
    if len(data) < MESSAGE_HEADER_LEN or random.random() < 0.2:
        return flip(data, random)
    return data[:2] + (MESSAGE_HEADER_LEN + len(body)).to_bytes(4, "big") + data[6:MESSAGE_HEADER_LEN] + body


def _llrp_seeds() -> list[bytes]:
    report = params.TagReportData(
        epc_parameter=params.EPC_96(epc=bytes(12)),
        antenna_id=params.AntennaID(antenna_id=1),
        peak_rssi=params.PeakRSSI(peak_rssi=-61),
        tag_seen_count=params.TagSeenCount(tag_count=3),
        first_seen_timestamp_utc=params.FirstSeenTimestampUTC(microseconds=1_700_000_000_000_000),
        last_seen_timestamp_uptime=params.LastSeenTimestampUptime(microseconds=5),
    )
    event = params.ReaderEventNotificationData(
        timestamp=params.UTCTimestamp(microseconds=1),
        connection_attempt_event=params.ConnectionAttemptEvent(status=0),
    )
    told = [
        messages.RO_ACCESS_REPORT(tag_report_datas=[report, report]),
        messages.READER_EVENT_NOTIFICATION(reader_event_notification_data=event),
        messages.KEEPALIVE(),
    ]
    return [message.to_bytes(message_id=1) for message in told]
