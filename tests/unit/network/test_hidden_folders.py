"""What a user may not see is said to be hidden, and not to be missing."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from clients.registrar import cli as registrar_cli
from clients.robot.cli.robot_choice import RobotPlace
from network.cli.contract.contract_signers import get_signers
from network.cli.governance.governance_signer import AdminOptions, open_network
from network.cli.node.node_commands import get_node_config
from network.provisioning.founding import find_own_entries
from network.provisioning.network_layout import create_network
from network.provisioning.node_backup import BackupManifest, _files_of, delete_old
from network.provisioning.node_certificates import get_authority

NOBODY = 65_534


@pytest.fixture(scope="module")
def network() -> Iterator[Path]:
    """In a folder whose parents everybody may enter."""
    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o755)
        folder = Path(place, "network")
        create_network(folder, nodes=1, organisations=1, base_port=20_000)
        folder.chmod(0o755)
        for inner in (folder / "nodes", folder / "nodes" / "node-1", folder / "organisations"):
            inner.chmod(0o755)
        yield folder


@contextmanager
def hidden(folder: Path) -> Iterator[None]:
    """From who runs this."""
    mode, user = folder.stat().st_mode, os.geteuid()
    folder.chmod(0o700 if user == 0 else 0)
    if user == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(user)
        folder.chmod(mode)


@pytest.mark.parametrize(
    ("place", "look"),
    [
        ("nodes/node-1", lambda folder: get_node_config("node-1", folder)),
        ("nodes/node-1", lambda folder: get_node_config(str(folder / "nodes" / "node-1"), None)),
        ("nodes", lambda folder: get_node_config("node-1", folder)),
        ("nodes/node-1", find_own_entries),
        ("organisations/hospital", lambda folder: AdminOptions(folder, "hospital").signer()),
        ("organisations/hospital", lambda folder: AdminOptions(folder).signer()),
        ("organisations", lambda folder: AdminOptions(folder, "hospital").signer()),
        ("organisations/hospital", lambda folder: get_signers(folder, "hospital", None, None)),
        ("organisations", lambda folder: get_signers(folder, "hospital/registrar", None, None)),
        ("organisations/hospital", lambda folder: get_signers(folder, None, None, None)),
        ("organisations/hospital", lambda folder: get_authority(folder, "hospital")),
        ("organisations/hospital", lambda _folder: registrar_cli._open(None, None)),
        (
            "organisations/hospital",
            lambda folder: RobotPlace(folder, folder / "genesis.json").get_approver("hospital"),
        ),
        ("nodes/node-1/keys", lambda folder: list(_files_of(folder / "nodes" / "node-1" / "keys"))),
        ("", open_network),
    ],
)
def test_a_folder_of_another_user_is_not_called_missing(
    network: Path, monkeypatch: pytest.MonkeyPatch, place: str, look: Callable[[Path], object]
) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(network.parent))
    assert look(network) is not None
    with hidden(network / place), pytest.raises(PermissionError, match="Permission denied"):
        look(network)


def test_backups_are_deleted_beside_a_folder_of_another_user(network: Path) -> None:
    made = BackupManifest(version=1, node="node-1", chain_id="", height=0, made_at_ms=1, files={})
    with hidden(network / "nodes" / "node-1"):
        assert delete_old(network / "nodes" / "new", made, 1) == []


def test_what_is_missing_is_still_called_missing(network: Path, tmp_path: Path) -> None:
    shutil.copytree(network, tmp_path / "network")
    shutil.rmtree(tmp_path / "network" / "organisations")
    for name in (None, "hospital"):
        with pytest.raises(Exception, match=r"^ORGANISATION_KEY_NOT_FOUND"):
            AdminOptions(tmp_path / "network", name).signer()
    with pytest.raises(Exception, match=r"^NOT_FOUND"):
        get_node_config("node-7", network)
