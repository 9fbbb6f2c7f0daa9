"""A local network with people, wallets and a robot, for demonstrations and experiments."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from msgspec import UNSET

from clients.registrar.registrar_answers import CardIssueAnswer, RosterMakeAnswer
from clients.robot.cli.robot_answers import RobotNewAnswer, RobotRegisterAnswer
from clients.sdk.new_files import write_private
from clients.sdk.terminal.json_answers import Answer
from clients.wallet.answers.consent_answers import FetchedReceipt, RegisterAnswer
from clients.wallet.answers.wallet_answers import NewWalletAnswer
from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.demo.processes import run_command, wallet_arguments
from network.demo.tampering import drop_databases
from network.notices.notice_publishing import publish_demo_notice
from network.provisioning.network_layout import create_network
from network.provisioning.new_organisation import ADMIN_KEY_FILE

PEERS_MAX_S = 10.0
NODES_COUNT = 4
ORGANISATIONS_COUNT = 2

A = TypeVar("A", bound=Answer)


class Stage:
    """One folder with a network, wallets and a robot; `start_network` comes first."""

    def __init__(self, folder: Path, *, store: str, base_port: int, purpose: str) -> None:
        self.network_dir = folder / "network"
        self.wallets = folder / "wallets"
        self.robots = folder / "robots"
        self.purpose = purpose
        self._store = store
        self._base_port = base_port
        self._cluster: Cluster | None = None
        self.receipts: dict[str, FetchedReceipt | None] = {}
        """The consent receipt of each person who was enrolled, as their wallet told it."""

    @property
    def cluster(self) -> Cluster:
        """Raises CLUSTER_NOT_RUNNING."""
        if self._cluster is None:
            raise BlockRobotError("CLUSTER_NOT_RUNNING")
        return self._cluster

    @property
    def genesis_file(self) -> Path:
        return self.network_dir / "genesis.json"

    @property
    def organisation(self) -> str:
        return self.cluster.genesis.organisations[0].name

    @property
    def approver_file(self) -> Path:
        return self.network_dir / "organisations" / self.organisation / ADMIN_KEY_FILE

    @property
    def roster_file(self) -> Path:
        return self.robots / "robot" / "roster.sealed"

    async def start_network(self, name: str, configure: Callable[[Cluster], None] | None = None) -> list[int]:
        """Start four nodes of two organisations, wait until ready; return their peer counts.

        `configure` may change their files before.
        """
        create_network(
            self.network_dir,
            nodes=NODES_COUNT,
            organisations=ORGANISATIONS_COUNT,
            base_port=self._base_port,
            store=self._store,
            network=f"{name}-{secrets.token_hex(4)}",
            faults=True,
        )
        self._cluster = Cluster(self.network_dir)
        if configure is not None:
            configure(self._cluster)
        self._cluster.start_all()
        await self._cluster.wait_ready()
        return await self._count_peers()

    async def publish_notice(self) -> int:
        return await publish_demo_notice(self.network_dir)

    async def _count_peers(self) -> list[int]:
        deadline = time.monotonic() + PEERS_MAX_S
        while True:
            reports = await self.cluster.status()
            peers = [len(report.status["peers"]) for report in reports if report.status]
            if min(peers, default=0) == len(reports) - 1 or time.monotonic() > deadline:
                return peers
            await asyncio.sleep(0.1)

    def registrar_arguments(self) -> list[str]:
        return [
            "--registrar-dir",
            str(self.network_dir / "organisations" / self.organisation),
            "--genesis",
            str(self.genesis_file),
        ]

    def robot_arguments(self, name: str = "robot") -> list[str]:
        return ["robot", "--name", name, "--robot-dir", str(self.robots), "--genesis", str(self.genesis_file)]

    async def wallet(self, profile: str, kind: type[A], *arguments: str) -> A:
        environment = {"BLOCKROBOT_PASSPHRASE_FILE": str(self.wallets / f"{profile}.passphrase")}
        command = [*wallet_arguments(self.wallets, profile, self.genesis_file), *arguments]
        return await run_command(command, kind, environment=environment)

    async def refusal(self, profile: str, *arguments: str) -> str:
        try:
            await self.wallet(profile, Answer, *arguments)
        except BlockRobotError as error:
            return error.code
        return ""

    async def issue_card(self, role: str, alias: str, uid: str) -> str:
        uid_file = self.wallets / f"{alias}.uid"
        write_private(uid_file, uid)
        try:
            answer = await run_command(
                ["card", "issue", *self.registrar_arguments(), "--role", role, "--uid-file", str(uid_file)],
                CardIssueAnswer,
            )
        finally:
            uid_file.unlink(missing_ok=True)  # also where no card was issued: a tag's UID never stays on disk
        return answer.code

    async def enrol_person(self, alias: str, uid: str) -> bool:
        """With card, wallet and consent; return whether keys match."""
        self.wallets.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_private(self.wallets / f"{alias}.passphrase", secrets.token_urlsafe(16))
        code = await self.issue_card("subject", alias, uid)
        words = self.wallets / f"{alias}.words"
        made = await self.wallet(alias, NewWalletAnswer, "new", "--fast-passphrase", "--words-file", str(words))
        registered = await self.wallet(alias, RegisterAnswer, "register", code, "--purpose", self.purpose, "--yes")
        self.receipts[alias] = None if registered.receipt is UNSET else registered.receipt
        return made.member == registered.member

    async def enrol_robot(self, name: str = "robot") -> str:
        self.wallets.mkdir(parents=True, exist_ok=True, mode=0o700)
        made = await run_command([*self.robot_arguments(name), "new"], RobotNewAnswer)
        code = await self.issue_card("robot", name, secrets.token_hex(12).upper())
        registered = await run_command([*self.robot_arguments(name), "register", code], RobotRegisterAnswer)
        if made.member != registered.member:
            raise BlockRobotError("INTERNAL", "The chain recovered another key than the robot's own.")
        return registered.member

    async def make_roster(self, robot: str, out: Path | None = None) -> int:
        where = str(out or self.roster_file)
        arguments = ["roster", "make", *self.registrar_arguments(), "--robot", robot, "--out", where]
        return (await run_command(arguments, RosterMakeAnswer)).rows

    async def stop(self) -> None:
        if self._cluster is not None:
            await asyncio.to_thread(self._cluster.stop_all)
            await asyncio.to_thread(drop_databases, self._cluster)
