"""SLIP-39's published test vectors, share by share through the wallet's own reading and gathering.

`slip39.json` holds the vectors of the standard (satoshilabs/slips, slip-0039; MIT licence): names, shares, and the secret
in hex or nothing where the shares have to be refused. Their passphrase is TREZOR; the wallet itself uses none.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from clients.wallet.recovery.slip39_shares import ShareCollector, read_share, require_of_wallet
from consensus.errors import BlockRobotError

VECTORS: list[dict[str, Any]] = json.loads(Path(__file__).with_name("slip39.json").read_text(encoding="utf-8"))
VALID = [vector for vector in VECTORS if vector["secret"]]
INVALID = [vector for vector in VECTORS if not vector["secret"]]
OF_THE_STANDARD = b"TREZOR"
REFUSED = {
    "invalid checksum": "SHARE_INVALID",
    "invalid padding": "SHARE_INVALID",
    "greater group threshold": "SHARE_INVALID",
    "insufficient length": "SHARE_INVALID",
    "invalid master secret length": "SHARE_INVALID",
    "different identifiers": "SHARE_OF_ANOTHER_SPLIT",
    "different iteration exponents": "SHARE_OF_ANOTHER_SPLIT",
    "mismatching group thresholds": "SHARE_OF_ANOTHER_SPLIT",
    "mismatching group counts": "SHARE_OF_ANOTHER_SPLIT",
    "mismatching member thresholds": "SHARE_OF_ANOTHER_SPLIT",
    "duplicate member indices": "SHARES_CONTRADICT",
    "invalid digest": "SHARES_CONTRADICT",
    "insufficient number of": "SHARES_TOO_FEW",
    "basic sharing 2-of-3": "SHARES_TOO_FEW",
}


def gather(vector: dict[str, Any]) -> ShareCollector:
    gathering = ShareCollector()
    for share in vector["shares"]:
        gathering.add(read_share(share))
    return gathering


def test_all_published_vectors_are_here() -> None:
    assert [vector["name"].split(".")[0] for vector in VECTORS] == [str(number) for number in range(1, 46)]
    assert len(VALID) >= 12


@pytest.mark.parametrize("vector", VALID, ids=lambda vector: vector["name"])
def test_shares_that_are_valid_lead_to_their_secret(vector: dict[str, Any]) -> None:
    gathering = gather(vector)
    assert gathering.is_complete
    assert gathering.join_secret(OF_THE_STANDARD).hex() == vector["secret"]


@pytest.mark.parametrize("vector", INVALID, ids=lambda vector: vector["name"])
def test_what_is_wrong_with_the_others_is_told_by_its_own_code(vector: dict[str, Any]) -> None:
    name = vector["name"].lower()
    (code,) = {code for part, code in REFUSED.items() if part in name}
    with pytest.raises(BlockRobotError) as refused:
        gather(vector).join()
    assert refused.value.code == code
    assert not set(refused.value.detail.lower().split()) & set(vector["shares"][0].split()[4:])


@pytest.mark.parametrize("vector", VALID, ids=lambda vector: vector["name"])
def test_only_shares_of_256_bits_that_lead_nowhere_alone_are_taken_for_a_wallet_s(vector: dict[str, Any]) -> None:
    share = read_share(vector["shares"][0])
    if len(vector["secret"]) == 64 and len(vector["shares"]) > 1:
        require_of_wallet(share)
        assert len(share.words()) == 33
    else:
        with pytest.raises(BlockRobotError, match="SHARE_INVALID"):
            require_of_wallet(share)
