"""Whatever a peer sends, the core neither raises nor says two things in one round (R2, R4, R14)."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from consensus.chain.block import IndexedSignature, QuorumCertificate, TimeoutCertificate
from consensus.chain.messages import CertificateNotice, Proposal, Timeout, Vote
from consensus.protocol.events import (
    BlocksFetched,
    NoticeReceived,
    ProposalReceived,
    TimeoutReceived,
    TimerFired,
    VoteReceived,
    WorkChanged,
)
from tests.unit.consensus.one_core import GENESIS_QC, NOW_MS, TRANSACTION, OneCore, Peers, committed, said

PEERS = Peers()
BOUNDARY = PEERS.boundary(2, PEERS.block(1))
CLOSING = [PEERS.closing(3, BOUNDARY), PEERS.closing(5, BOUNDARY, tc=PEERS.tc(4, 2))]
CHAIN = [
    *PEERS.chain(1, 2, 3, 5, 6),
    *PEERS.chain(1, 4),
    PEERS.block(1, transactions=(TRANSACTION,)),
    BOUNDARY,
    *CLOSING,
    PEERS.closing(4, CLOSING[0]),
    PEERS.closing(6, CLOSING[1]),
    PEERS.block(3, BOUNDARY),
]
numbers = st.one_of(st.integers(-2, 8), st.integers(-(2**63), 2**64 - 1))
signatures = st.binary(max_size=66)
blocks = st.sampled_from(CHAIN)
wild_qcs = st.builds(
    QuorumCertificate,
    epoch=numbers,
    round=numbers,
    block_id=st.binary(max_size=33),
    votes=st.lists(st.builds(IndexedSignature, index=numbers, signature=signatures), max_size=4).map(tuple),
)
qcs = st.one_of(blocks.map(PEERS.qc), st.just(GENESIS_QC), wild_qcs)
tcs = st.one_of(
    st.none(),
    st.builds(PEERS.tc, st.integers(1, 6), st.integers(0, 3)),
    st.builds(TimeoutCertificate, epoch=numbers, round=numbers, timeouts=st.just(())),
)
wild_blocks = st.builds(
    lambda block, field, value: PEERS.block(
        max(1, block.header.round), **{"qc": block.header.qc, "parent_id": block.header.parent_id, field: value}
    ),
    blocks,
    st.sampled_from(["height", "round", "epoch", "producer", "timestamp_ms", "gas_used", "version"]),
    numbers,
)
proposals = st.one_of(
    blocks,
    wild_blocks,
    st.builds(lambda block, data: msgspec.structs.replace(block, header_bytes=data), blocks, st.binary(max_size=40)),
    st.builds(lambda block, data: msgspec.structs.replace(block, transactions=(data,)), blocks, st.binary(max_size=40)),
)
votes = st.one_of(
    st.builds(PEERS.vote, st.integers(0, 3), blocks),
    st.builds(Vote, epoch=numbers, round=numbers, block_id=st.binary(max_size=33), index=numbers, signature=signatures),
)
timeouts = st.one_of(
    st.builds(PEERS.timeout, st.integers(0, 3), st.integers(1, 6), qcs.filter(lambda qc: qc.round >= 0), tcs),
    st.builds(Timeout, epoch=numbers, round=numbers, index=numbers, signature=signatures, qc=qcs, entered_by=tcs),
)
events = st.one_of(
    st.builds(lambda block: ProposalReceived(Proposal(block=block), sender=1, now_ms=NOW_MS), proposals),
    st.builds(lambda vote: VoteReceived(vote=vote, now_ms=NOW_MS), votes),
    st.builds(lambda timeout: TimeoutReceived(timeout=timeout, sender=None, now_ms=NOW_MS), timeouts),
    st.builds(lambda qc, tc: NoticeReceived(CertificateNotice(qc=qc, entered_by=tc), now_ms=NOW_MS), qcs, tcs),
    st.builds(lambda some: BlocksFetched(blocks=tuple(some), now_ms=NOW_MS), st.lists(proposals, max_size=3)),
    st.builds(lambda kind: (kind,), st.sampled_from(["round", "resend", "heartbeat", "propose", "fetch"])),
    st.builds(lambda pending: WorkChanged(pending=pending, now_ms=NOW_MS), st.booleans()),
)


@given(st.lists(events, max_size=25))
def test_nothing_that_peers_send_makes_the_core_raise_or_contradict_itself(script):
    node = OneCore()
    voted: dict[int, bytes] = {}
    given_up: set[int] = set()
    highest = 0
    for step in script:
        event = step if not isinstance(step, tuple) else TimerFired(kind=step[0], round=node.core.round, now_ms=NOW_MS)
        had_ended = node.core.has_ended
        effects = node.executed(node.handle(event))
        assert not any(block.header.is_closing for block in committed(effects))
        for timeout in said(effects, Timeout):
            given_up.add(timeout.round)
        for vote in said(effects, Vote):
            assert not had_ended
            assert voted.setdefault(vote.round, vote.block_id) == vote.block_id
            assert vote.round not in given_up
        assert node.core.finalized.height >= highest
        highest = node.core.finalized.height
