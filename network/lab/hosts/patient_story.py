"""The story of a robot and a patient's wallet on a host without a node: all they need comes over TLS from other hosts."""

from __future__ import annotations

import secrets
from pathlib import Path

from msgspec import Struct

from consensus.bounded_text import read_json_as
from network.lab.hosts.founded_network import FoundedNetwork
from network.lab.hosts.outcomes import Tell

RECORD_S = 20
PURPOSE = "demo"


class Patient(Struct, kw_only=True):
    """What the robot says it recorded of the patient, and what the patient's wallet finds and opens.

    `hosts`: the addresses of clients' ports, none of which is of the robot's and the wallet's own host.
    """

    hosts: list[str]
    kept_frames: int
    records: int
    verified: int
    pictures: int

    def failures(self) -> list[str]:
        """What did not go as it should, in sentences."""
        found = [] if self.records and self.kept_frames else ["nothing was recorded"]
        found += [] if self.verified == self.records else [f"{self.records - self.verified} records are not verified"]
        found += [] if self.pictures == self.kept_frames else [f"{self.pictures} pictures of {self.kept_frames} opened"]
        return found + [f"{url} is not over TLS" for url in self.hosts if not url.startswith("https://")]


def record_from_elsewhere(network: FoundedNetwork, tell: Tell) -> Patient:
    """The desk is the hospital's, and so is the eye that looks at the empty frames; the rest happens at the visitor's."""
    hospital, ward = network.hosts["hospital"], network.visitor
    genesis = ward.home / "genesis.json"
    genesis.write_bytes(network.genesis_path.read_bytes())
    (ward.home / "passphrase").write_text(f"{secrets.token_hex(16)}\n", encoding="utf-8")
    network.run(hospital, "notice", "new", "notice.toml")
    network.run(hospital, "notice", "publish", "notice.toml", "--as", "hospital", "--yes")
    robot = ("robot", "--genesis", str(genesis))
    made = network.ask(ward, *robot, "new")
    network.ask(ward, *robot, "register", network.issue_card("robot-of-the-ward", "robot"))
    tell("A robot is registered from a host without a node, by the genesis file alone.")
    folder = Path(str(made["folder"]))
    desk = network.folder("hospital") / "organisations" / "hospital"
    sealed = str(folder / "roster.sealed")
    roster = ("roster", "make", "--registrar-dir", str(desk), "--robot", str(made["member"]), "--out", sealed)
    network.run(hospital, *roster)
    run = (*robot, "run", "--seconds", str(RECORD_S), "--purpose", PURPOSE)
    network.run(ward, *run, fails=True)  # its empty frames are to be looked at first, at the hospital
    network.run(hospital, "frames", "approve", str(folder / "empty-frames"), "--yes", "--as", "hospital")
    tell("The hospital looked at the robot's empty frames, and approved them.")
    tags = read_json_as((ward.home / "br" / "recordings" / "tags.json").read_bytes(), dict[str, str])
    wallet = ("wallet", "--genesis", str(genesis))
    network.run(ward, *wallet, "new", "--words-file", "words", "--fast-passphrase")
    card = network.issue_card(tags["patient-a"], "subject")
    network.run(ward, *wallet, "register", card, "--purpose", PURPOSE, "--yes")
    network.run(hospital, *roster)
    network.propose("clinic")  # a consent counts from the block after its own, for which an idle network takes a minute
    tell(f"A patient has registered with a wallet and said yes. The robot records for {RECORD_S} s.")
    recorded = network.ask(ward, *run)
    listed = network.ask(ward, *wallet, "records")
    viewed = network.ask(ward, *wallet, "view", "--out", "pictures", "--no-sheet")
    answer = Patient(
        hosts=[node.api_url for node in network.genesis.nodes],
        kept_frames=int(recorded["frames"]["kept"]),
        records=int(listed["all_records"]),
        verified=sum(record["verdict"] == "verified" for record in viewed["records"]),
        pictures=len(list((ward.home / "pictures").rglob("*.depth.png"))),
    )
    tell(
        f"The wallet found {answer.records} records, verified {answer.verified} and opened {answer.pictures} pictures."
    )
    return answer
