"""A small real network with a person whom a robot has recorded: what the stories of pages begin with.

Four node processes of two organisations, a published notice, a registered person, ann, whose wallet file lies where
`blockrobot wallet` looks for it, and a robot that has recorded her walking alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from clients.robot.recording.frame_answers import FrameCounts
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.store.keystore import Keystore
from consensus.chain.genesis import Genesis
from network.notices.notice_publishing import publish_demo_notice
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_rights import Ward
from tests.walking_alone import UID

PASSPHRASE = "tea"
PROFILE = "ann"


class RecordedNetwork:
    """The running network, the person's wallet file and what she owns; `record` lets the robot see her once more."""

    profile = PROFILE
    passphrase = PASSPHRASE

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.network = NetworkUnderTest(folder / "network", nodes=4)
        self.wallet_dir = folder / "wallets"
        self.passphrase_file = self.wallet_dir / f"{PROFILE}.passphrase"
        self.records: list[RecordEntry] = []
        """Her records as of the last recording, oldest first."""

    @property
    def genesis(self) -> Genesis:
        """The genesis of the network."""
        return self.network.genesis

    @property
    def genesis_file(self) -> Path:
        """Where the genesis file is, for `--genesis`."""
        return self.network.folder / "genesis.json"

    @property
    def wallet_arguments(self) -> list[str]:
        """The beginning of a wallet's command: `wallet`, the folder, the profile, the genesis file."""
        return self.arguments_of(PROFILE)

    def arguments_of(self, profile: str) -> list[str]:
        """The beginning of a command of another profile's wallet."""
        options = ["--wallet-dir", str(self.wallet_dir), "--profile", profile, "--genesis", str(self.genesis_file)]
        return ["wallet", *options]

    def api_url(self, name: str) -> str:
        """Where a node answers over HTTP; the names are `network.names`."""
        return self.network.url(name)

    @asynccontextmanager
    async def wallet(self, profile: str = PROFILE) -> AsyncIterator[Wallet]:
        """Open a wallet in this process, as the command line would; one that is not there yet is made."""
        path = self.wallet_dir / f"{profile}.wallet"
        if path.exists():
            store = await asyncio.to_thread(Keystore.open, path, PASSPHRASE)
            async with Wallet(store, self.genesis) as opened:
                yield opened
        else:
            async with self._ward.wallet(profile) as made:
                yield made

    async def start(self) -> None:
        """Start the nodes, register the person and the robot, and record her once."""
        await self.start_unregistered()
        async with self.wallet() as ann:
            await ann.register(self.issue_card(UID, "subject"), [])
            await ConsentClient(ann).give(["demo"], ["depth"])
        await self.prepare_robot()
        await self.record()

    async def start_unregistered(self) -> None:
        """Start the nodes, publish the notice, and make the person's wallet: nobody is registered, nobody recorded."""
        self.wallet_dir.mkdir(mode=0o700)
        self.passphrase_file.write_text(PASSPHRASE, encoding="utf-8")
        self.passphrase_file.chmod(0o600)
        await self.network.start()
        await publish_demo_notice(self.network.folder)
        self._ward = Ward(self.network, self.wallet_dir)
        async with self.wallet():
            pass

    async def prepare_robot(self) -> None:
        """Register the robot, and give it the roster of who consents."""
        await self._ward.prepare_robot()

    async def record(self) -> FrameCounts:
        """Let the robot record her walk once more, as a visit of its own; return the counts of frames."""
        frames = await self._ward.record()
        assert frames.kept > 0
        async with self.wallet() as ann:
            reports = await ann.records()
        self.records = [entry for report in reports for entry in report.records]
        assert any(entry.metadata.sensor == "depth" for entry in self.records)
        return frames

    def issue_card(self, uid: str, role: str) -> str:
        """Let the registrar issue a card for somebody else (`staff`, `officer`, `subject`); return its code."""
        return self._ward.desk.issue(uid, role)

    async def close(self) -> None:
        """End every process."""
        await self.network.close()
