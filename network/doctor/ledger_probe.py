"""Examines the ledgers of data directories.

A damaged LMDB file can kill its reader, so a child process reads and prints a JSON line per ledger; the ledger at which
it dies is damaged.

    python -m network.doctor.ledger_probe DATA_DIR...
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from consensus.bounded_text import read_json_text
from consensus.chain.block import Block, compute_header_id
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.trie import verify_proof
from consensus.state.keys import flat_prefix
from consensus.state.membership import MEMBERSHIP
from consensus.state.producers import EPOCH
from consensus.visible_text import split_lines
from contracts.execution.epochs import read_epoch
from node.config import NodeConfig, load_config, load_genesis
from node.consensus.epoch_change import read_head
from node.storage.ledger_store import LedgerSnapshot
from node.storage.lmdb_reader import LedgerFile
from node.storage.lmdb_store import DATA_FILE_NAME

BLOCKS_CHECKED_COUNT = 512
KEYS_PROVED_COUNT = 64
PROBE_TIMEOUT_S = 60.0


@dataclass(frozen=True, slots=True)
class LedgerFacts:
    """A ledger's newest block; `trouble` is empty if intact, `height` -1 if none.

    `is_foreign`: it has begun by another genesis file.
    """

    name: str
    trouble: str
    height: int = -1
    block_id: str = ""
    state_root: str = ""
    timestamp_ms: int = 0
    heartbeat_ms: int = 0
    max_clock_drift_ms: int = 0
    production: str = ""
    roots: dict[int, str] = field(default_factory=dict)
    """State roots by height, as the newest block headers have them."""
    is_foreign: bool = False


def probe(config: NodeConfig) -> LedgerFacts:
    if not (config.ledger_dir / DATA_FILE_NAME).exists():
        return LedgerFacts(config.name, "")
    try:
        genesis = load_genesis(config)
        with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as snapshot:
            position = snapshot.position
            if position is None:
                return LedgerFacts(config.name, "")
            if snapshot.block_height(genesis.block_id) != 0:
                trouble = "Its ledger has begun by another genesis file than its genesis.json."
                return LedgerFacts(config.name, trouble, is_foreign=True)
            head = read_head(snapshot, genesis).block
            epoch = read_epoch(snapshot)
            roots: dict[int, str] = {}
            if compute_header_id(head.header) != position.block_id:
                trouble = f"Block {position.height} is not the one that the ledger's head names."
            elif head.header.state_root != position.state_root:
                trouble = f"The state's root is not that of block {position.height}."
            else:
                trouble = _check_links(snapshot, position.height, roots) or _check_state(snapshot, position.state_root)
            return LedgerFacts(
                name=config.name,
                trouble=trouble,
                height=position.height,
                block_id=position.block_id.hex(),
                state_root=position.state_root.hex(),
                timestamp_ms=position.timestamp_ms,
                heartbeat_ms=epoch.settings.heartbeat_ms,
                max_clock_drift_ms=epoch.settings.max_clock_drift_ms,
                production=epoch.settings.production,
                roots=roots,
            )
    except BlockRobotError as error:
        return LedgerFacts(config.name, error.detail)


def _check_links(snapshot: LedgerSnapshot, height: int, roots: dict[int, str]) -> str:
    parent: bytes | None = None
    for number, data in snapshot.iter_blocks(max(0, height - BLOCKS_CHECKED_COUNT), BLOCKS_CHECKED_COUNT + 1):
        header = decode(data, Block).header
        if parent is not None and header.parent_id != parent:
            return f"Block {number} does not follow the block before it."
        parent = compute_header_id(header)
        roots[number] = header.state_root.hex()
    return ""


def _check_state(snapshot: LedgerSnapshot, root: bytes) -> str:
    rows = [*snapshot.scan(flat_prefix(MEMBERSHIP), KEYS_PROVED_COUNT), (EPOCH.flat, snapshot.get(EPOCH.flat))]
    try:
        for key, value in rows:
            verify_proof(root, key, value, snapshot.prove(key))
    except BlockRobotError:
        return "The stored state does not lead to the state root of the newest block."
    return ""


def probe_ledgers(configs: Sequence[NodeConfig]) -> dict[str, LedgerFacts]:
    waiting = list(configs)
    seen: dict[str, LedgerFacts] = {}
    while waiting:
        seen |= _run_child(waiting)
        left = [config for config in waiting if config.name not in seen]
        if left:  # the child died of the first one that it did not report
            seen[left[0].name] = LedgerFacts(left[0].name, "The program that reads it dies of it.")
        waiting = left[1:]
    return seen


def _run_child(configs: Sequence[NodeConfig]) -> dict[str, LedgerFacts]:
    command = [sys.executable, "-m", "network.doctor.ledger_probe", *(str(config.data_dir) for config in configs)]
    try:
        output = subprocess.run(command, capture_output=True, timeout=PROBE_TIMEOUT_S, check=False).stdout
    except subprocess.TimeoutExpired as error:
        output = error.stdout or b""
    seen = {}
    for line in split_lines(output.decode()):
        if line.endswith("}"):
            fields = read_json_text(line)
            fields["roots"] = {int(height): root for height, root in fields["roots"].items()}
            seen[fields["name"]] = LedgerFacts(**fields)
    return seen


def main(arguments: Sequence[str]) -> int:
    for argument in arguments:
        config = load_config(Path(argument))
        facts = probe(config)
        line = json.dumps({name: getattr(facts, name) for name in LedgerFacts.__dataclass_fields__})
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
