"""Decoded finalized headers: leader, voters, missed rounds.

A certificate is in the child's header, a finality proof, or the next epoch's proof.
"""

from __future__ import annotations

from consensus.api_documents import describe
from consensus.chain.block import EpochProof, Header, QuorumCertificate, TimeoutCertificate, certificate_of
from consensus.chain.genesis import Genesis
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.hashing import sha256
from consensus.state.membership import active_nodes, active_organisations
from consensus.state.producers import CANDIDATE, EPOCH, KEYS, CandidateRow
from contracts.lifecycle.describing import list_contracts
from node.api.explorer_documents import (
    CertificateDocument,
    CountsDocument,
    EpochDocument,
    EvidenceDocument,
    HeaderDocument,
    ProducerDocument,
    ProducersAnswer,
    SeatDocument,
    TimeoutDocument,
)
from node.api.ports import RoundWatch
from node.storage.ledger_view import BlockHead, LedgerView

MISSED_SHOWN_MAX_COUNT = 32


class HeaderReader:
    """Reads headers of one snapshot; caches the epochs' schedules."""

    def __init__(self, snapshot: LedgerView, genesis: Genesis, watch: RoundWatch | None = None) -> None:
        self._snapshot = snapshot
        self._watch = watch
        self._genesis = genesis
        self._schedules: dict[int, Schedule] = {0: genesis.schedule}
        self._heads: dict[int, BlockHead | None] = {}

    def schedule(self, epoch: int) -> Schedule:
        """Raises NOT_FOUND."""
        if epoch not in self._schedules:
            data = self._snapshot.epoch_proof(epoch)
            if data is None:
                raise BlockRobotError("NOT_FOUND", f"The chain has not entered epoch {epoch}.")
            self._schedules[epoch] = Schedule.of(decode(data, EpochProof).epoch)
        return self._schedules[epoch]

    def _head(self, height: int) -> BlockHead | None:
        if height not in self._heads:
            self._heads[height] = self._snapshot.head(height) if height >= 0 else None
        return self._heads[height]

    def _header(self, height: int) -> Header | None:
        head = self._head(height)
        return None if head is None else decode(head.header_bytes, Header)

    def read(self, height: int) -> HeaderDocument | None:
        head = self._head(height)
        if head is None:
            return None
        header, block_id = decode(head.header_bytes, Header), sha256(head.header_bytes)
        own = self._own_certificate(header, block_id)
        missed = self._missed_rounds(header)
        schedule = self.schedule(header.epoch)
        return describe(
            HeaderDocument,
            header,
            block_id=block_id.hex(),
            transaction_count=head.transactions_count,
            finality_lag_ms=None if self._watch is None else self._watch.finality_lag_ms(height),
            certificate=None if own is None else _certificate(own),
            parent_certificate=_certificate(header.qc),
            timeout=None if header.tc is None else _timeout(header.tc),
            missed_count=len(missed),
            missed=[schedule.leader(number) for number in missed[:MISSED_SHOWN_MAX_COUNT]],
        )

    def _own_certificate(self, header: Header, block_id: bytes) -> QuorumCertificate | None:
        if header.height == 0:
            return None
        found = None
        if header.is_boundary:
            data = self._snapshot.epoch_proof(header.epoch + 1)
            found = None if data is None else certificate_of(decode(data, EpochProof).finality)
        elif header.height == self._snapshot.header.height:
            proof = self._snapshot.finality
            found = None if proof is None else certificate_of(proof)
        else:
            child = self._header(header.height + 1)
            found = None if child is None else child.qc
        return found if found is not None and found.block_id == block_id and found.votes else None

    def _missed_rounds(self, header: Header) -> range:
        if header.height == 0:
            return range(0)
        parent = self._header(header.height - 1)
        before = parent.round if parent is not None and parent.epoch == header.epoch else 0
        return range(before + 1, header.round)


def _certificate(qc: QuorumCertificate) -> CertificateDocument:
    return CertificateDocument(
        epoch=qc.epoch, round=qc.round, block_id=qc.block_id.hex(), voters=[vote.index for vote in qc.votes]
    )


def _timeout(tc: TimeoutCertificate) -> TimeoutDocument:
    voters = [timeout.index for timeout in tc.timeouts]
    return TimeoutDocument(epoch=tc.epoch, round=tc.round, voters=voters, highest_qc_round=tc.highest_qc_round)


def describe_epoch(reader: HeaderReader, snapshot: LedgerView, genesis: Genesis, number: int) -> EpochDocument:
    """With its seats' names. Raises NOT_FOUND."""
    schedule = reader.schedule(number)
    leading = set(range(len(schedule.producers))) - set(schedule.leaderless) or set(range(len(schedule.producers)))
    return EpochDocument(
        number=number,
        quorum=schedule.quorum,
        faults_tolerated=schedule.faults_tolerated,
        blocks_per_turn=schedule.blocks_per_turn,
        seats=[
            SeatDocument(index=index, name=_name_of(snapshot, genesis, key), key=key.hex(), leads=index in leading)
            for index, key in enumerate(schedule.producers)
        ],
    )


def _name_of(snapshot: LedgerView, genesis: Genesis, key: bytes) -> str:
    candidate = CANDIDATE.at(snapshot, key)
    if candidate is not None:
        return candidate.name
    return next((node.name for node in genesis.nodes if node.producer_key == key), "")


def describe_producers(snapshot: LedgerView) -> ProducersAnswer:
    epoch = EPOCH.read(snapshot)
    seats = {} if epoch is None else {key: index for index, key in enumerate(epoch.producers)}
    rows = {key: CANDIDATE.at(snapshot, key) for key in KEYS.read(snapshot) or []}
    return ProducersAnswer(
        height=snapshot.header.height,
        epoch=snapshot.header.epoch if epoch is None else epoch.number,
        producers=[_producer(key, row, seats.get(key)) for key, row in rows.items() if row is not None],
    )


def _producer(key: bytes, row: CandidateRow, seat: int | None) -> ProducerDocument:
    fields = row.evidence
    evidence = None
    if fields:
        evidence = EvidenceDocument(
            kind=fields["kind"],
            epoch=fields["epoch"],
            round=fields["round"],
            height=fields["height"],
            first_id=fields["first_id"].hex(),
            second_id=fields["second_id"].hex(),
        )
    return describe(ProducerDocument, row, key=key.hex(), seat=seat, evidence=evidence)


def count_all(snapshot: LedgerView) -> CountsDocument:
    """Count what the chain governs, never people; cached for each state."""
    root = snapshot.header.state_root
    counts = _counted.get(root)
    if counts is None:
        counts = _count(snapshot)
        _counted.clear()
        _counted[root] = counts
    return counts


_counted: dict[bytes, CountsDocument] = {}


def _count(snapshot: LedgerView) -> CountsDocument:
    epoch = EPOCH.read(snapshot)
    return CountsDocument(
        organisations=len(active_organisations(snapshot)),
        nodes=len(active_nodes(snapshot)),
        producers=0 if epoch is None else len(epoch.producers),
        contracts=len(list_contracts(snapshot)),
    )
