"""Publishes an organisation's privacy notice with its admin's key; the demonstration hospital's is shipped."""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path

from clients.sdk.chain.notices import read_notice
from clients.sdk.network_client import NetworkClient, open_pinned_client
from clients.sdk.trust_pin import PIN_FILE
from consensus.bounded_text import read_toml_text
from consensus.chain.genesis import genesis_from_json
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.rights.notices import Notice, PublishedNotice, encode_notice, notice_from
from network.provisioning.new_organisation import ADMIN_KEY_FILE

DEMO_ORGANISATION = "hospital"


def demo_notice_text() -> str:
    return resources.files("network.notices").joinpath("demo_notice.toml").read_text(encoding="utf-8")


@cache
def demo_notice() -> Notice:
    return notice_from(read_toml_text(demo_notice_text()))


async def publish_notice(
    client: NetworkClient, key: PrivateKey, organisation: str, notice: Notice
) -> tuple[PublishedNotice, bool]:
    """Unless in force; return whether it is new.

    Raises NOTICE_INVALID, NOTICE_NOT_FOUND if another admin was faster, and as `NetworkClient.call`.
    """
    before = await read_notice(client, organisation)
    if before is not None and before.notice == notice:
        return before, False
    await client.call(key, "consent", "publish_notice", [encode_notice(notice)])
    after = await read_notice(client, organisation)
    if after is None or after.notice != notice:
        raise BlockRobotError("NOTICE_NOT_FOUND", "Another version was published at the same time; look at it first.")
    return after, True


async def publish_demo_notice(folder: Path) -> int:
    """Publish the demonstration's notice on a local network unless present; return its version.

    Raises as `publish_notice`; OSError without the hospital's admin key.
    """
    genesis = genesis_from_json((folder / "genesis.json").read_text(encoding="utf-8"))
    key = PrivateKey((folder / "organisations" / DEMO_ORGANISATION / ADMIN_KEY_FILE).read_bytes())
    async with open_pinned_client(genesis, folder / PIN_FILE) as client:
        known = await read_notice(client, DEMO_ORGANISATION)
        if known is None:
            known, _ = await publish_notice(client, key, DEMO_ORGANISATION, demo_notice())
        return known.row.version
