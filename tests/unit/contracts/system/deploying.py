"""Small contracts, and how a consortium uploads, deploys, upgrades and disables them."""

from __future__ import annotations

from typing import Any

from consensus.chain.block import Receipt
from consensus.primitives.keys import PrivateKey
from contracts.lifecycle.registry import compute_source_hash
from tests.unit.contracts.system.consortium import Consortium, admin_of, data_of

PART_BYTES = 6000

VISITORS = '''
@export
def enter(name: str):
    """Note that somebody came in."""
    state.put(b"in/" + name.encode(), ctx.height)


@export
def leave(name: str):
    """Note that somebody left."""
    state.delete(b"in/" + name.encode())


@view
def inside() -> list:
    """Return the names of those inside."""
    return [key[3:].decode() for key, _ in state.scan(b"in/", 100)]
'''

VISITORS_2 = '''
@export
def enter(name: str, floor: int):
    """Note that somebody came in, and to which floor."""
    state.put(b"at/" + name.encode(), [floor, ctx.height])


@view
def inside() -> list:
    """Return [name, floor] of those inside."""
    return [[key[3:].decode(), value[0]] for key, value in state.scan(b"at/", 100)]


@migrate
def carry_over():
    """Whoever came in before is on the ground floor."""
    for key, height in state.scan(b"in/", 100):
        state.put(b"at/" + key[3:], [0, height])
        state.delete(key)
'''

FAILING = VISITORS_2.replace("for key, height", 'require(False, "TOO_EARLY", "Not yet.")\n    for key, height')


def deployment(name: str, source: str, **more: Any) -> dict[str, Any]:
    """The arguments of a proposal to deploy."""
    return {"name": name, "source_hash": compute_source_hash(source), "height": 0, "delay": 0, "note": ""} | more


def activation(name: str, version: int, **more: Any) -> dict[str, Any]:
    """The arguments of a proposal to activate a version."""
    return {"name": name, "version": version, "height": 0, "delay": 0, "note": ""} | more


def disabling(name: str, version: int = 1, **more: Any) -> dict[str, Any]:
    """The arguments of a proposal to disable a contract."""
    return {"name": name, "version": version, "height": 0, "delay": 0, "note": ""} | more


def keeping(name: str, version: int = 2) -> dict[str, Any]:
    """The arguments of a proposal to keep a version that is on trial."""
    return {"name": name, "version": version}


def parts_of(source: str) -> list[bytes]:
    """A source cut into the parts that are uploaded."""
    data = source.encode()
    return [data[first : first + PART_BYTES] for first in range(0, len(data), PART_BYTES)]


def upload(chain: Consortium, key: PrivateKey, source: str, *, checked: bool = True) -> None:
    """Upload all parts of a source, and have it checked."""
    parts = parts_of(source)
    for place, data in enumerate(parts):
        chain.must(key, "lifecycle", "upload", compute_source_hash(source), len(parts), place, data)
    if checked:
        chain.must(key, "lifecycle", "check_upload", compute_source_hash(source))


def agree(chain: Consortium, kind: str, arguments: dict[str, Any]) -> Receipt:
    """One proposes, and a majority approves. Return the receipt of the last approval."""
    first, *others = chain.majority()
    receipt = chain.must(admin_of(first), "lifecycle", "propose", kind, arguments)
    proposal_id = receipt.txid
    for name in others:
        receipt = chain.must(admin_of(name), "lifecycle", "approve", proposal_id)
    return receipt


def deploy(chain: Consortium, name: str, source: str, **more: Any) -> int:
    """Upload and agree on a source; return the height at which it will be active."""
    upload(chain, admin_of(chain.majority()[0]), source)
    return int(data_of(agree(chain, "deploy", deployment(name, source, **more)), "scheduled")["height"])


def upgrade(chain: Consortium, name: str, source: str) -> None:
    """Deploy a source, and let the block come with which it takes effect."""
    height = deploy(chain, name, source)
    chain.block([])
    assert chain.height == height
