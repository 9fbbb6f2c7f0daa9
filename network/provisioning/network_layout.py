"""Creates a network on disk, in one go: the founding of a network whose parties are all on this machine.

DIRECTORY/genesis.json
DIRECTORY/organisations/<name>/   ca.crt.pem, ca.key.pem, admin.key, registrar.key, organisation-entry.json
DIRECTORY/nodes/<name>/           node.toml, genesis.json, node-entry.json, keys/, journal/
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Collection
from pathlib import Path

from clients.sdk.new_files import read_given_file
from consensus.chain.genesis import ChainSettings, Genesis
from consensus.errors import BlockRobotError
from consensus.limits import PRODUCERS_MAX_COUNT
from consensus.primitives.keys import PRIVATE_KEY_SIZE_BYTES, PrivateKey
from network.provisioning.founding import adopt_genesis, find_own_entries, make_genesis
from network.provisioning.founding_entries import read_offers
from network.provisioning.network_files import remove_marked
from network.provisioning.network_removal import MAKING_MARK, marked_as_making, remove_abandoned
from network.provisioning.new_node import Founder, NewNode, create_node
from network.provisioning.new_organisation import ADMIN_KEY_FILE, create_organisation
from node.config import LOOPBACK

FIRST_PORT = 7_272
PORTS_PER_NODE = 10
NETWORK_FOLDER_MODE = 0o755
_ORGANISATION_NAMES = ("hospital", "university")


def organisation_name(number: int) -> str:
    return _ORGANISATION_NAMES[number] if number < len(_ORGANISATION_NAMES) else f"organisation-{number + 1}"


def create_network(
    directory: Path,
    *,
    nodes: int = 4,
    organisations: int = 2,
    base_port: int,
    store: str = "sqlite",
    network: str = "blockrobot",
    settings: ChainSettings | None = None,
    faults: bool = False,
    followers: int = 0,
    archives: Collection[str] = (),
) -> Genesis:
    """Create a network atomically; return its genesis. `faults`: permit fault injection.

    The last `followers` are no producers; `archives` keep every block. Node i (from 0) listens on base_port + 10*i
    (peers), +1 (clients), +2 (operator); each organisation's first node is a custodian. `store`: `sqlite` or a MongoDB
    URI. Raises CONFIGURATION_INVALID, DATA_DIRECTORY_INVALID if a network exists, FOLDER_NOT_EMPTY.
    """
    if not 1 <= nodes <= PRODUCERS_MAX_COUNT or not 1 <= organisations <= nodes:
        raise BlockRobotError(
            "CONFIGURATION_INVALID", f"A network has 1 to {PRODUCERS_MAX_COUNT} nodes, and no more organisations."
        )
    if not 0 < base_port <= 65_535 - PORTS_PER_NODE * nodes:
        raise BlockRobotError("CONFIGURATION_INVALID", "The base port leaves no room for the nodes' ports.")
    unknown = sorted({*archives} - {f"node-{number + 1}" for number in range(nodes)})
    if unknown:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The network has no node {unknown[0]!r} to be an archive.")
    if (directory / "genesis.json").exists():
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is a network in {directory} already.")
    if directory.exists() and any(directory.iterdir()):
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{directory} is not empty, and what is in it is no network.")
    directory.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(directory)
    making = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", dir=directory.parent))
    try:
        making.chmod(NETWORK_FOLDER_MODE)
        with marked_as_making(making):
            genesis = _write_network(
                making,
                nodes,
                organisations,
                base_port,
                store,
                network,
                settings,
                faults=faults,
                followers=followers,
                archives=archives,
            )
            _put_in_place(making, directory)
        (directory / MAKING_MARK).unlink(missing_ok=True)
    except BaseException:
        with contextlib.suppress(OSError):
            remove_marked(making, MAKING_MARK)
        raise
    return genesis


def _put_in_place(making: Path, directory: Path) -> None:
    try:
        making.rename(directory)
    except OSError as error:
        text = f"Something came into {directory} while the network was made: perhaps another command makes one there."
        raise BlockRobotError("FOLDER_NOT_EMPTY", text) from error


def _write_network(
    directory: Path,
    nodes: int,
    organisations: int,
    base_port: int,
    store: str,
    network: str,
    settings: ChainSettings | None,
    *,
    faults: bool,
    followers: int,
    archives: Collection[str],
) -> Genesis:
    now_ms = time.time_ns() // 1_000_000
    owners = [organisation_name(number) for number in range(organisations)]
    authorities = {name: create_organisation(directory, name)[0] for name in owners}
    for number in range(nodes):
        owner = owners[number % organisations]
        new = NewNode(
            name=f"node-{number + 1}",
            organisation=owner,
            host=LOOPBACK,
            base_port=base_port + PORTS_PER_NODE * number,
            store=store,
            is_custodian=number < organisations,
            is_producer=number < nodes - followers,
            faults=faults,
            archive=f"node-{number + 1}" in archives,
        )
        admin = PrivateKey(
            read_given_file(directory / "organisations" / owner / ADMIN_KEY_FILE, PRIVATE_KEY_SIZE_BYTES)
        )
        create_node(directory / "nodes" / new.name, new, authorities[owner], network, founder=Founder(admin, now_ms))
    genesis = make_genesis(*read_offers(find_own_entries(directory)), network=network, settings=settings)
    adopt_genesis(genesis, directory, [directory / "nodes" / entry.name for entry in genesis.nodes])
    return genesis
