"""After a whole story, every file of every node is searched: no secret is in any of them but the node's own key files."""

from __future__ import annotations

import asyncio
import base64
import secrets
from pathlib import Path

import pytest

from clients.registrar.registrar import Registrar
from clients.sdk.network_client import NetworkClient
from consensus.members.vouchers import decode_card_code
from tests.cluster.network_under_test import NetworkUnderTest
from tests.security.intruder import Intruder, new_key
from tests.security.ward import Enrolled, Ward

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.smoke]

FETCH_TIMEOUT_S = 10.0
KEY_FILES = frozenset({"producer.key", "custodian.key", "tls.key.pem"})


def _forms(secret: bytes) -> list[bytes]:
    """The shapes in which a secret might lie about: raw, hexadecimal, Base64 and Base32."""
    hexadecimal = secret.hex().encode()
    return [
        secret,
        hexadecimal,
        hexadecimal.upper(),
        base64.b64encode(secret).rstrip(b"="),
        base64.urlsafe_b64encode(secret).rstrip(b"="),
        base64.b32encode(secret).rstrip(b"="),
    ]


def find_secrets(folder: Path, wanted: dict[str, bytes]) -> list[tuple[str, str]]:
    """Return (name of the secret, file) for each secret found in any file below a folder, in any form."""
    needles = [(name, form) for name, secret in wanted.items() for form in _forms(secret)]
    found = []
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            content = path.read_bytes()
            found += [(name, str(path.relative_to(folder))) for name, form in needles if form in content]
    return found


def _secrets_of(who: Enrolled, name: str) -> dict[str, bytes]:
    assert who.card is not None
    return {
        f"{name}'s identity key": who.identity.secret,
        f"{name}'s spend key": who.spend.secret,
        f"{name}'s view key": who.view.secret,
        f"{name}'s sealing key": bytes(who.sealing),
        f"{name}'s card secret": who.card.card_secret,
    }


async def _download(intruder: Intruder, record_id: bytes, access_id: bytes, token: dict[str, str]) -> bytes:
    path = f"/v1/clips/{record_id.hex()}?access_id={access_id.hex()}"
    deadline = asyncio.get_running_loop().time() + FETCH_TIMEOUT_S
    while (answer := await intruder.ask("GET", path, headers=token))[0] != 200:
        assert asyncio.get_running_loop().time() < deadline, answer
        await asyncio.sleep(0.05)
    return answer[2]


async def _tell_story(network: NetworkUnderTest, intruder: Intruder) -> dict[str, bytes]:
    """Enrol, register, record, fetch, erase one frame, fail here and there; return every secret there was."""
    desk = Registrar(network.folder / "organisations" / network.genesis.organisations[0].name, network.genesis)
    uid = secrets.token_hex(12).upper()
    ward = Ward(intruder)
    ward.patient.card = decode_card_code(desk.issue(uid, "subject"))
    await ward.open()
    assert (await desk.make_roster(ward.robot.identity.public_key)).rows == 1
    wanted = {"tag's UID (text)": uid.encode(), "tag's UID (bytes)": bytes.fromhex(uid)}
    clip = ward.clip()
    tokens = {}
    for name in network.names:
        tokens[f"robot at {name}"] = await intruder.session(ward.robot.identity, name)
        tokens[f"patient at {name}"] = await intruder.session(ward.patient.identity, name)
        tokens[f"owner at {name}"] = await intruder.session(ward.owner, name)
    for node in network.genesis.nodes:
        if node.custodian_key:
            assert (await ward.upload(clip.upload, node.name, tokens[f"robot at {node.name}"]))[0] == 200
    assert (await intruder.final(ward.record_call(clip)))["ok"]
    record_id = clip.upload.record_id
    access = await ward.must(ward.owner, "access", "request", [record_id], "own-access")
    await _download(intruder, record_id, access.txid, tokens[f"owner at {intruder.node}"])
    await ward.must(ward.owner, "erasure", "request", [record_id], [0])
    await _make_mistakes(intruder, ward, tokens)
    async with NetworkClient(network.genesis) as client:
        await client.announcements(0, ward.patient.identity)
    wanted |= _secrets_of(ward.patient, "patient") | _secrets_of(ward.robot, "robot")
    wanted |= {"owner key": ward.owner.secret, "visit secret": ward.visit_secret}
    wanted |= {f"data key {index}": key for index, key in enumerate(clip.data_keys)}
    wanted |= {f"picture {index}": text[:48] for index, text in enumerate(clip.plaintexts)}
    wanted |= {f"token of {name}": bytes.fromhex(token["Authorization"][7:]) for name, token in tokens.items()}
    return wanted


async def _make_mistakes(intruder: Intruder, ward: Ward, tokens: dict[str, dict[str, str]]) -> None:
    """Whoever puts a secret where it does not belong must not find it in a log: tokens and keys in addresses."""
    token = tokens[f"owner at {intruder.node}"]["Authorization"][7:]
    for path in (
        f"/v1/{ward.patient.identity.secret.hex()}",
        f"/v1/transactions/{token}",
        f"/v1/finality?token={token}",
        f"/v1/clips/{ward.owner.secret.hex()}",
    ):
        await intruder.ask("GET", path, headers={"Authorization": f"Bearer {token}"})
    await intruder.ask("POST", "/v1/session-challenges", json={"public_key": ward.patient.identity.secret.hex()})
    await intruder.ask("POST", "/v1/queries", json={"contract": token[:32], "view": "x", "args": token})
    await intruder.raw(b"GET /" + token.encode() + b" HTTP/9\r\nX: " + token.encode() + b"\r\n\r\n")


def _own_keys(network: NetworkUnderTest) -> dict[str, bytes]:
    """The keys of nodes and organisations, each by the file that is its home."""
    keys = {}
    for path in network.folder.rglob("*.key"):
        keys[str(path.relative_to(network.folder))] = path.read_bytes()
    for path in network.folder.rglob("*.key.pem"):
        keys[str(path.relative_to(network.folder))] = path.read_bytes().splitlines()[1]
    return keys


async def test_after_a_whole_story_no_file_of_a_node_holds_a_secret(
    network: NetworkUnderTest, intruder: Intruder
) -> None:
    wanted = await _tell_story(network, intruder)
    public = intruder.genesis.chain_id
    assert find_secrets(network.folder / "nodes", {"what is there": public}), "the search finds nothing at all"
    assert find_secrets(network.folder / "nodes", wanted) == []
    for name in network.names:
        network.cluster.stop(name)
    assert find_secrets(network.folder / "nodes", wanted) == []
    for name in network.names:
        network.cluster.start(name)
    await network.cluster.wait_ready()
    await intruder.final(network.transaction())


async def test_every_key_lies_in_its_own_file_for_its_user_only(network: NetworkUnderTest) -> None:
    keys = _own_keys(network)
    assert len(keys) == 4 + 2 + 4 + 2 * 3
    for home, key in keys.items():
        places = {path for _, path in find_secrets(network.folder, {home: key})}
        assert places == {home}
    files = [network.folder / home for home in _own_keys(network)]
    files += list(network.folder.rglob("cards.json"))
    files += [path for path in network.folder.rglob("erase-keys/*") if path.is_file()]
    for path in files:
        assert path.stat().st_mode & 0o777 == 0o600, path
    # The custody database and the ledger tell who was where when; folders keep other users out.
    for config in network.cluster.configs.values():
        assert config.data_dir.stat().st_mode & 0o077 == 0, config.data_dir


async def test_the_search_finds_a_secret_in_every_form(tmp_path: Path) -> None:
    key = new_key()
    for index, form in enumerate(_forms(key.secret)):
        (tmp_path / f"file-{index}").write_bytes(b"before " + form + b" after")
    found = {path for _, path in find_secrets(tmp_path, {"key": key.secret})}
    assert found == {f"file-{index}" for index in range(len(_forms(key.secret)))}
