"""Lets the custodians of a measurement keep their clips in folders of their own or in an S3 bucket."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import shutil
from collections.abc import AsyncIterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from clients.sdk.new_files import replace_file
from consensus.errors import BlockRobotError
from network.cluster import Cluster
from node.clips_place import FOLDER_DEFAULT_NAME, REGION_DEFAULT, ClipsPlace, read_place
from node.config import CONFIG_FILE, config_to_toml
from node.custody.stores.open_store import open_blobs

REMOVED_AT_ONCE_COUNT = 64


@dataclass(frozen=True, slots=True)
class ClipsApart:
    """`url`: `folder`, a folder in each custodian's own, or s3://BUCKET/PREFIX, of which each has a part of its own.

    Raises CONFIGURATION_INVALID where it is used.
    """

    url: str
    endpoint: str = ""
    region: str = REGION_DEFAULT
    ca_path: Path | None = None
    credentials_path: Path | None = None
    run: str = field(default_factory=lambda: f"bench-{secrets.token_hex(4)}")

    @property
    def kind(self) -> str:
        """Of the place, without its address."""
        return self.url.partition(":")[0]

    def place_of(self, custodian: str, folder: Path) -> ClipsPlace:
        """`folder`: the custodian's own."""
        if self.url == "folder":
            return read_place(f"folder:{FOLDER_DEFAULT_NAME}", folder)
        if self.kind != "s3":  # any other folder would never be emptied
            raise BlockRobotError("CONFIGURATION_INVALID", "--clips is folder, or s3://BUCKET/PREFIX.")
        url = f"{self.url.rstrip('/')}/{self.run}/{custodian}"
        return read_place(
            url,
            folder,
            endpoint=self.endpoint,
            region=self.region,
            ca_path=self.ca_path,
            credentials_path=self.credentials_path,
        )

    def configure(self, cluster: Cluster) -> None:
        """Before its first start."""
        for node in cluster.genesis.custodians:
            config = cluster.config(node.name)
            changed = replace(config, clips=self.place_of(node.name, config.data_dir))
            replace_file(config.data_dir / CONFIG_FILE, config_to_toml(changed).encode())

    async def remove(self, folder: Path) -> None:
        """Delete what the custodians of this run left in a bucket. Raises STORE_UNAVAILABLE."""
        if self.kind == "s3":
            async with open_blobs(self.place_of("", folder)) as blobs:
                names = [name async for name in blobs.names()]
                for first in range(0, len(names), REMOVED_AT_ONCE_COUNT):
                    await asyncio.gather(*map(blobs.delete, names[first : first + REMOVED_AT_ONCE_COUNT]))


@contextlib.asynccontextmanager
async def removed_after(folder: Path, apart: ClipsApart | None) -> AsyncIterator[None]:
    """A measurement's folder, which has keys, whatever happens. Raises STORE_UNAVAILABLE for a bucket, if nothing else."""
    try:
        try:
            yield
        except BaseException:
            if apart is not None:
                with contextlib.suppress(BlockRobotError):
                    await apart.remove(folder)
            raise
        if apart is not None:
            await apart.remove(folder)
    finally:
        await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
