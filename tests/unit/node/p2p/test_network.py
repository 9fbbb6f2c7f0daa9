"""Links follow the directory and the certificates: who leaves is cut off, who comes is let in, nobody restarts."""

from __future__ import annotations

import socket
import threading
from collections import Counter
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path

import pytest
from msgspec.structs import replace

from network.provisioning.certificate_authority import create_authority
from node.p2p import network as links_module
from node.p2p.connection import PeerConnection
from node.p2p.wire import FrameKind
from pages.name_lookups import NameLookups
from tests.cluster.network_under_test import find_base_port
from tests.twin_authority import twin_of
from tests.unit.node.p2p.linked_nodes import LinkedNodes, days, eventually

THREE = {"n1": "hospital", "n2": "university", "n3": "hospital"}
DAY_MS = 24 * 3600 * 1000


@pytest.fixture
async def network(tmp_path: Path) -> AsyncIterator[LinkedNodes]:
    network = LinkedNodes(tmp_path)
    try:
        yield network
    finally:
        await network.close()


async def all_linked(network: LinkedNodes, *names: str) -> None:
    for name in names:
        others = sorted(set(names) - {name})
        await eventually(lambda name=name, others=others: network.nodes[name].links.connected == others)


async def test_all_nodes_are_linked_once_each(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.nodes["n1"].links.broadcast(FrameKind.VOTE, b"vote")
    await eventually(lambda: network.nodes["n3"].heard.frames == [("n1", FrameKind.VOTE, b"vote")])
    assert network.nodes["n1"].heard.links_made.count("n2") == 1


async def test_who_dials_does_not_depend_on_the_order_in_genesis(network: LinkedNodes) -> None:
    """Two nodes may know each other from different beginnings; they agree all the same."""
    await network.start({"n3": "hospital", "n1": "hospital", "n2": "university"})
    await all_linked(network, "n1", "n2", "n3")


async def test_a_removed_node_is_cut_off_at_once_and_told_why(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.declare("n2", "university", status="removed")
    network.state.height += 1
    for name in ("n1", "n3"):
        network.nodes[name].directory.refresh(network.state, network.state.height)
    assert "n2" not in network.nodes["n1"].links.connected
    assert "n2" not in network.nodes["n3"].links.connected
    await eventually(lambda: network.nodes["n2"].refused_by().get("n3") == "PEER_REMOVED")
    assert network.nodes["n2"].links.connected == []
    assert network.nodes["n1"].links.connected == ["n3"]


async def test_nothing_that_a_removed_node_sent_late_is_heard(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.nodes["n2"].links.broadcast(FrameKind.VOTE, b"late")
    network.declare("n2", "university", status="removed")
    network.nodes["n1"].directory.refresh(network.state, 1)
    network.nodes["n1"].links.broadcast(FrameKind.VOTE, b"mine")
    await eventually(lambda: ("n1", FrameKind.VOTE, b"mine") in network.nodes["n3"].heard.frames)
    await eventually(lambda: network.nodes["n2"].links.connected == ["n3"])
    assert [frame for frame in network.nodes["n1"].heard.frames if frame[0] == "n2"] == []


async def test_the_nodes_of_a_removed_organisation_are_cut_off(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.state.put_organisation("university", network.authorities["university"].certificate_pem, "removed")
    network.finalize()
    assert network.nodes["n1"].links.connected == ["n3"]
    problem = network.nodes["n2"].links.own_problem()
    assert problem is not None
    assert problem.code == "NODE_REMOVED"
    await network.nodes["n2"].links.stop()
    await network.start({"n2": "university"})  # from what it knew at first
    await eventually(lambda: network.nodes["n2"].refused_by().get("n3") == "PEER_REMOVED")


async def test_a_revoked_certificate_counts_no_more_and_a_new_one_does(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.state.revoke("university", network.serials["n2"])
    network.finalize()
    assert network.nodes["n1"].links.connected == ["n3"]
    await eventually(lambda: network.nodes["n1"].refused() == {"n2": "PEER_CERTIFICATE_REVOKED"})
    await eventually(lambda: network.nodes["n2"].refused_by().get("n1") == "PEER_CERTIFICATE_REVOKED")
    network.certify("n2", "university")
    network.nodes["n2"].links.reload_certificate()
    await all_linked(network, *THREE)
    assert network.nodes["n1"].refused() == {}
    assert network.nodes["n2"].links.own_problem() is None


async def test_a_serial_of_another_organisation_revokes_nothing(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.state.revoke("hospital", network.serials["n2"])
    network.finalize()
    assert network.nodes["n1"].links.connected == ["n2", "n3"]


async def test_a_new_node_of_a_new_organisation_is_let_in_without_a_restart(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    library = network.authorities["library"] = create_authority("library")
    for name in ("n0", "n4"):  # one that dials everybody, one that everybody dials
        network.declare(name, "library")
    network.state.put_organisation("library", library.certificate_pem)
    network.finalize()
    await network.start({"n0": "library", "n4": "library"})
    network.finalize()
    await all_linked(network, *THREE, "n0", "n4")


async def test_a_node_that_moved_is_found_at_its_new_address(network: LinkedNodes) -> None:
    await network.start({"n1": "hospital", "n2": "university"})
    await all_linked(network, "n1", "n2")
    moved = network.nodes["n2"]
    await moved.links.stop()
    network.ports["n2"] = find_base_port(1)
    network.declare("n2", "university")
    network.finalize()
    await network.start({"n2": "university"})
    network.finalize()
    await all_linked(network, "n1", "n2")


async def test_names_that_nobody_answers_for_hold_up_neither_an_honest_one_nor_the_stop(
    network: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: Counter[str] = Counter()
    given_up = threading.Event()

    def look(host: str) -> list[str]:
        asked[host] += 1
        if host != "n2.example":
            given_up.wait(60)
            raise socket.gaierror(socket.EAI_AGAIN, "no server answered")
        return ["127.0.0.99", "127.0.0.1"]  # nobody listens at the first

    monkeypatch.setattr(links_module, "NameLookups", partial(NameLookups, look))
    monkeypatch.setattr(links_module, "DIAL_TIMEOUT_MS", 200)
    network.prepare({"n1": "hospital", "n2": "hospital"})
    await network.start({"n1": "hospital"})
    mute = [f"m{count}" for count in range(24)]
    for name in mute:
        network.state.put_node(name, "university", find_base_port(1), host=f"{name}.example")
    network.state.put_node("n2", "hospital", network.ports["n2"], host="n2.example")
    network.finalize()
    monkeypatch.setattr(links_module, "MISSED_AFTER_MS", 50)
    await eventually(lambda: len(asked) == 25)
    await network.start({"n2": "hospital"})
    await eventually(lambda: network.nodes["n1"].links.connected == ["n2"])
    await eventually(lambda: asked["n2.example"] > 1)
    await network.close()
    assert {asked[f"{name}.example"] for name in mute} == {1}
    given_up.set()


async def test_a_renewed_certificate_is_taken_up_by_a_running_node(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    before = network.nodes["n2"].links.describe()["certificate"]["serial"]
    serial = network.certify("n2", "university")
    await eventually(lambda: network.nodes["n2"].links.describe()["certificate"]["serial"] == f"{serial:x}")
    assert before != f"{serial:x}"
    await eventually(lambda: network.nodes["n1"].heard.links_made.count("n2") == 2)
    await eventually(lambda: network.nodes["n3"].heard.links_made.count("n2") == 2)
    await all_linked(network, *THREE)


async def test_a_half_written_certificate_disturbs_nothing(network: LinkedNodes) -> None:
    await network.start({"n1": "hospital", "n2": "university"})
    await all_linked(network, "n1", "n2")
    path = network.config("n2").tls_certificate_path
    whole = path.read_bytes()
    path.write_bytes(whole[:100])
    links = network.nodes["n2"].links
    links.reload_certificate()
    assert network.nodes["n2"].refused_by() == {"n2": "CONFIGURATION_INVALID"}
    path.write_bytes(whole)
    links.reload_certificate()
    assert network.nodes["n2"].refused_by() == {}
    await all_linked(network, "n1", "n2")


async def test_an_expired_certificate_is_refused_by_name_until_it_is_renewed(network: LinkedNodes) -> None:
    network.ports["n2"] = find_base_port(1)
    network.certify("n2", "university", lifetime=days(-0.5))
    await network.start(THREE)
    await all_linked(network, "n1", "n3")
    await eventually(lambda: network.nodes["n1"].refused() == {"n2": "PEER_CERTIFICATE_EXPIRED"})
    problem = network.nodes["n2"].links.own_problem()
    assert problem is not None
    assert problem.code == "CERTIFICATE_EXPIRED"
    assert "expired on" in problem.detail
    network.certify("n2", "university")
    await all_linked(network, *THREE)
    assert network.nodes["n2"].links.own_problem() is None


async def test_a_link_ends_with_its_certificate(network: LinkedNodes) -> None:
    network.ports["n2"] = find_base_port(1)
    network.certify("n2", "university", lifetime=days(10))
    await network.start(THREE)
    await all_linked(network, *THREE)
    assert network.nodes["n2"].links.describe()["certificate"]["state"] == "expiring"
    for node in network.nodes.values():
        node.clock_offset_ms = 11 * DAY_MS
    await all_linked(network, "n1", "n3")
    assert network.nodes["n2"].links.describe()["certificate"]["state"] == "expired"
    assert network.nodes["n1"].refused() == {"n2": "PEER_CERTIFICATE_EXPIRED"}


async def test_a_replaced_authority_makes_strangers_of_its_old_certificates(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.authorities["university"] = create_authority("university")
    network.state.put_organisation("university", network.authorities["university"].certificate_pem)
    network.finalize()
    assert network.nodes["n1"].links.connected == ["n3"]
    assert network.nodes["n1"].refused()["n2"] == "PEER_CERTIFICATE_FOREIGN"
    network.certify("n2", "university")
    network.nodes["n2"].links.reload_certificate()
    await all_linked(network, *THREE)


@pytest.mark.parametrize("status", ["active", "removed"])
async def test_an_organisation_whose_authorities_look_like_others_keeps_no_nodes_apart(
    network: LinkedNodes, status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor a newcomer, who dials before it knows itself."""
    monkeypatch.setattr(links_module, "MISSED_AFTER_MS", 60_000)
    await network.start(THREE)
    await all_linked(network, *THREE)
    twins = [twin_of(authority, "evil") for authority in network.authorities.values()]
    text = "".join(each.certificate_pem for each in (create_authority("evil"), *twins))
    network.state.put_organisation("evil", text, status)
    network.finalize()
    for node in network.nodes.values():
        node.heard.links_made.clear()
    for name, organisation in THREE.items():
        network.certify(name, organisation)
        network.nodes[name].links.reload_certificate()
    await eventually(
        lambda: all(set(node.heard.links_made) == {*THREE} - {name} for name, node in network.nodes.items())
    )
    await all_linked(network, *THREE)
    network.declare("n0", "hospital")
    network.finalize()
    await network.start({"n0": "hospital"})
    await all_linked(network, *THREE, "n0")
    assert all(node.refused() == {} for node in network.nodes.values())


async def test_an_authority_that_nobody_can_read_harms_its_own_organisation_only(network: LinkedNodes) -> None:
    await network.start(THREE)
    await all_linked(network, *THREE)
    network.state.put_organisation("university", "not a certificate")
    network.finalize()
    await all_linked(network, "n1", "n3")


async def test_two_nodes_with_different_genesis_files_tell_each_other_in_what(network: LinkedNodes) -> None:
    names = {"a": "hospital", "b": "university"}
    first = network.prepare(names)
    await network.start({"a": "hospital"})
    network.genesis = replace(first, purposes=("care",), created_at_ms=first.created_at_ms + 1)
    await network.start({"b": "university"})
    for name, other in (("a", "b"), ("b", "a")):
        links = network.nodes[name].links
        await eventually(lambda links=links: bool(links.describe()["refused_peers"]))  # type: ignore[misc]
        (refused,) = links.describe()["refused_peers"]
        assert (refused["peer"], refused["code"]) == (other, "GENESIS_DIFFERS")
        assert refused["detail"].endswith("What differs: name or beginning, purposes.")
        assert links.connected == []


async def test_a_node_that_is_behind_a_firewall_dials_also_those_before_it(
    network: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links_module, "MISSED_AFTER_MS", 50)
    names = {"a": "hospital", "b": "university"}
    network.prepare(names)
    network.ports["b"] = find_base_port(1)  # not where its entry says: nobody reaches it
    await network.start(names)
    await all_linked(network, *names)
    (connection,) = network.nodes["b"].links._open
    assert connection.dialled == "a"
    alive = connection.transport.get_extra_info("socket").getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    assert alive == 1


async def test_of_two_links_both_sides_keep_the_one_that_the_lower_name_dialled(
    network: LinkedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links_module, "MISSED_AFTER_MS", 0)
    await network.start(THREE)
    await all_linked(network, *THREE)

    def is_settled() -> bool:
        kept = [link for node in network.nodes.values() for link in node.links._open]
        return len(kept) == 6 and all(link.dialled is None or link.dialled > name_of(link) for link in kept)

    def name_of(link: PeerConnection) -> str:
        return next(name for name, node in network.nodes.items() if link in node.links._open)

    await eventually(is_settled)
    network.nodes["n1"].links.broadcast(FrameKind.VOTE, b"vote")
    await eventually(lambda: network.nodes["n3"].heard.frames == [("n1", FrameKind.VOTE, b"vote")])
