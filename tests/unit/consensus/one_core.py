"""One production core among scripted peers: the test says what they send and sees what the core does about it."""

from __future__ import annotations

from typing import TypeVar

from consensus.chain.block import (
    HEADER_VERSION,
    Block,
    Header,
    IndexedSignature,
    QuorumCertificate,
    TimeoutCertificate,
    TimeoutSignature,
    compute_transactions_root,
    genesis_certificate,
)
from consensus.chain.genesis import ChainSettings
from consensus.chain.messages import (
    SIGNING,
    CertificateNotice,
    LastSignedResponse,
    Proposal,
    SignedMessage,
    Timeout,
    Vote,
    sign_block,
    sign_timeout,
    sign_vote,
)
from consensus.chain.schedule import Epoch, Schedule, compute_epoch_hash
from consensus.chain.signature_cache import SignatureCache
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.protocol.core import Core
from consensus.protocol.effects import BuildBlock, CommitBlocks, Effect, ExecuteBlock, Message, Persist
from consensus.protocol.events import (
    BlockBuilt,
    BlockExecuted,
    Event,
    LastSignedReceived,
    NoticeReceived,
    ProposalReceived,
    Started,
    TimeoutReceived,
    TimerFired,
    VoteReceived,
    WorkChanged,
)
from tests.sim.named_chain import (
    CHAIN_ID,
    EPOCH_START_MS,
    NO_RECEIPTS_ROOT,
    build_block,
    make_genesis_block,
    make_keys,
    make_transaction,
    txid_of,
)

NOW_MS = EPOCH_START_MS
GENESIS = make_genesis_block()
GENESIS_QC = QuorumCertificate(epoch=0, round=0, block_id=GENESIS.block_id, votes=())
TRANSACTION = make_transaction(1)
CHECK = SignatureCache()

E = TypeVar("E", bound=Effect)
M = TypeVar("M", bound=Message)


class Peers:
    """All keys of one epoch's producers: whatever they could sign, the test can. `root` is where the epoch begins."""

    def __init__(
        self,
        count: int = 4,
        blocks_per_turn: int = 1,
        *,
        epoch: int = 0,
        root: Block = GENESIS,
        first_key: int = 0,
        chain_id: bytes = CHAIN_ID,
    ) -> None:
        self.chain_id = chain_id
        self.keys = make_keys(first_key + count)[first_key:]
        self.schedule = Schedule(epoch, tuple(key.public_key for key in self.keys), blocks_per_turn)
        self.epoch, self.root, self.root_qc = epoch, root, genesis_certificate(root.block_id, epoch)
        self.signers = tuple(range(self.schedule.quorum))

    def block(
        self,
        round_number: int,
        parent: Block | None = None,
        qc: QuorumCertificate | None = None,
        tc: TimeoutCertificate | None = None,
        *,
        transactions: tuple[bytes, ...] = (),
        timestamp_ms: int | None = None,
        **changes: object,
    ) -> Block:
        """Return the leader's signed block of a round; `changes` replace header fields before it is signed."""
        parent = parent or self.root
        above = parent.header
        fields: dict[str, object] = {
            "version": HEADER_VERSION,
            "chain_id": self.chain_id,
            "epoch": self.epoch,
            "height": above.height + 1,
            "round": round_number,
            "parent_id": parent.block_id,
            "qc": qc or self.qc(parent),
            "tc": tc,
            "producer": self.schedule.leader(round_number),
            "timestamp_ms": above.timestamp_ms + 1 if timestamp_ms is None else timestamp_ms,
            "transactions_root": compute_transactions_root([txid_of(wire) for wire in transactions]),
            "receipts_root": NO_RECEIPTS_ROOT,
            "state_root": sha256(above.state_root + b"".join(transactions)),
            "next_schedule_hash": None,
            "gas_used": 0,
        }
        fields.update(changes)
        data = encode(Header(**fields))  # type: ignore[arg-type]
        key = self.keys[self.schedule.leader(round_number)]
        signature = sign_block(key, self.chain_id, self.schedule.epoch, round_number, sha256(data))
        return Block(header_bytes=data, signature=signature, transactions=transactions)

    def boundary(
        self,
        round_number: int,
        parent: Block | None = None,
        following: Epoch | None = None,
        tc: TimeoutCertificate | None = None,
    ) -> Block:
        """Return a block that ends the epoch; `following` is the next one (these producers again, unless said)."""
        next_hash = compute_epoch_hash(following or self.following())
        return self.block(round_number, parent, tc=tc, transactions=(TRANSACTION,), next_schedule_hash=next_hash)

    def following(self, producers: tuple[bytes, ...] | None = None) -> Epoch:
        """Return the epoch after this one, with these producers or others."""
        keys = producers or self.schedule.producers
        return Epoch(number=self.epoch + 1, producers=keys, leaderless=(), settings=ChainSettings())

    def closing(
        self, round_number: int, parent: Block, tc: TimeoutCertificate | None = None, **changes: object
    ) -> Block:
        """Return a closing block on a boundary or on another closing block."""
        fields = {"is_closing": True, "state_root": parent.header.state_root, **changes}
        return self.block(round_number, parent, tc=tc, **fields)  # type: ignore[arg-type]

    def chain(self, *rounds: int, transactions: tuple[bytes, ...] = ()) -> list[Block]:
        """Return blocks of these rounds, each on the one before; a gap of rounds is bridged by a TC."""
        blocks: list[Block] = []
        parent = self.root
        for number in rounds:
            below = 0 if parent is self.root else parent.header.round
            tc = self.tc(number - 1, below) if number - below > 1 else None
            parent = self.block(number, parent, tc=tc, transactions=() if blocks else transactions)
            blocks.append(parent)
        return blocks

    def vote(self, index: int, block: Block) -> Vote:
        return sign_vote(self.keys[index], self.chain_id, self.epoch, block.header.round, block.block_id, index)

    def qc(self, block: Block, voters: tuple[int, ...] | None = None) -> QuorumCertificate:
        if block.block_id == self.root.block_id:
            return self.root_qc
        chosen = self.signers if voters is None else voters
        votes = tuple(IndexedSignature(index=i, signature=self.vote(i, block).signature) for i in chosen)
        return QuorumCertificate(epoch=self.epoch, round=block.header.round, block_id=block.block_id, votes=votes)

    def timeout(
        self,
        index: int,
        round_number: int,
        qc: QuorumCertificate | None = None,
        entered_by: TimeoutCertificate | None = None,
    ) -> Timeout:
        key = self.keys[index]
        return sign_timeout(key, self.chain_id, round_number, index, qc or self.root_qc, entered_by, self.epoch)

    def tc(self, round_number: int, *qc_rounds: int, signers: tuple[int, ...] | None = None) -> TimeoutCertificate:
        """Return a TC whose signers named these QC rounds (the last one also for the rest)."""
        chosen = self.signers if signers is None else signers
        named = list(qc_rounds or (0,))
        entries = []
        for place, index in enumerate(chosen):
            number = named[min(place, len(named) - 1)]
            qc = QuorumCertificate(epoch=self.epoch, round=number, block_id=bytes(32), votes=())
            signature = self.timeout(index, round_number, qc).signature
            entries.append(TimeoutSignature(index=index, qc_round=number, signature=signature))
        return TimeoutCertificate(epoch=self.epoch, round=round_number, timeouts=tuple(entries))


class OneCore(Peers):
    """The core of producer `index` (a follower if it is None) and everybody else's keys.

    Certificates are signed by others where that is possible: a word of its own that it never said would silence it.
    """

    def __init__(
        self,
        index: int | None = 3,
        *,
        count: int = 4,
        settings: ChainSettings | None = None,
        journal: list[bytes] | None = None,
        start: bool = True,
        answered: bool = True,
        epoch: int = 0,
        root: Block = GENESIS,
    ) -> None:
        """Make the core; `answered` (or, in a later epoch, having spoken in the one before) lets it speak at once."""
        self.settings = settings or ChainSettings()
        super().__init__(count, self.settings.blocks_per_turn, epoch=epoch, root=root)
        self.index = index
        others = [peer for peer in range(count) if peer != index]
        self.signers = tuple(sorted([*others, index or 0][: self.schedule.quorum]))
        self.now_ms = NOW_MS
        self.journal: list[bytes] = list(journal or [])
        self.core = Core(
            self.settings,
            CHAIN_ID,
            self.schedule,
            None if index is None else self.keys[index],
            finalized=root,
            finalized_qc=self.root_qc,
            round_zero_id=root.block_id,
            journal=self.journal,
            check=CHECK,
        )
        if answered and epoch > 0:
            self.core._voter.signing_guard._is_asking = False
        self.started = self.handle(Started(now_ms=self.now_ms)) if start else []
        if start and answered and index is not None:
            for peer in others[: self.schedule.quorum - 1]:
                self.started += self.answer_from(peer)

    def handle(self, event: Event) -> list[Effect]:
        """Give the core one event; what it persists goes to `journal`."""
        effects = self.core.handle(event)
        for effect in effects:
            if isinstance(effect, Persist):
                self.journal.extend(effect.records)
        return effects

    def executed(self, effects: list[Effect], *, valid: bool = True) -> list[Effect]:
        """Answer every ExecuteBlock among the effects, and those that follow; return all effects in order."""
        every = list(effects)
        for effect in effects:
            if isinstance(effect, ExecuteBlock):
                event = BlockExecuted(block_id=effect.block.block_id, valid=valid, now_ms=self.now_ms)
                every += self.executed(self.handle(event), valid=valid)
        return every

    def receive(self, block: Block, *, valid: bool = True, sender: int | None = None) -> list[Effect]:
        """A proposal arrives and is executed."""
        event = ProposalReceived(proposal=Proposal(block=block), sender=sender, now_ms=self.now_ms)
        return self.executed(self.handle(event), valid=valid)

    def vote_from(self, index: int, block: Block) -> list[Effect]:
        return self.executed(self.handle(VoteReceived(vote=self.vote(index, block), now_ms=self.now_ms)))

    def timeout_from(
        self,
        index: int,
        round_number: int,
        qc: QuorumCertificate | None = None,
        entered_by: TimeoutCertificate | None = None,
    ) -> list[Effect]:
        timeout = self.timeout(index, round_number, qc, entered_by)
        return self.handle(TimeoutReceived(timeout=timeout, sender=index, now_ms=self.now_ms))

    def answer_from(
        self,
        peer: int,
        *,
        message: SignedMessage | None = None,
        signing_state: str = SIGNING,
        signed_round: int = 0,
        qc: QuorumCertificate | None = None,
        entered_by: TimeoutCertificate | None = None,
    ) -> list[Effect]:
        """A peer says what it last heard of this producer (nothing, unless said), and how far it is itself."""
        answer = LastSignedResponse(
            epoch=self.epoch,
            asked_at_ms=self.now_ms,
            signing_state=signing_state,
            signed_round=signed_round,
            message=message,
            qc=qc or self.root_qc,
            entered_by=entered_by,
        )
        return self.handle(LastSignedReceived(answer=answer, sender=peer, now_ms=self.now_ms))

    def notice(self, qc: QuorumCertificate, entered_by: TimeoutCertificate | None = None) -> list[Effect]:
        notice = CertificateNotice(qc=qc, entered_by=entered_by)
        return self.executed(self.handle(NoticeReceived(notice=notice, now_ms=self.now_ms)))

    def work(self, pending: bool = True) -> list[Effect]:
        return self.handle(WorkChanged(pending=pending, now_ms=self.now_ms))

    def fire(self, kind: str, round_number: int | None = None) -> list[Effect]:
        number = self.core.round if round_number is None else round_number
        return self.handle(TimerFired(kind=kind, round=number, now_ms=self.now_ms))

    def built(self, order: BuildBlock, transactions: tuple[bytes, ...] = ()) -> list[Effect]:
        """Build the block that the core ordered, and give it back."""
        assert self.index is not None
        parent = self.core.block(order.parent_id) or self.root
        block = build_block(order, parent.header, transactions, self.keys[self.index], self.now_ms)
        return self.handle(BlockBuilt(round=order.round, block=block, now_ms=self.now_ms))

    def restarted(self) -> OneCore:
        """Return a core that reads the same journal, as after a crash (the store still holds genesis only)."""
        return OneCore(self.index, count=len(self.keys), settings=self.settings, journal=self.journal)


def of_type(effects: list[Effect], kind: type[E]) -> list[E]:
    """Return the effects of one kind."""
    return [effect for effect in effects if isinstance(effect, kind)]


def said(effects: list[Effect], kind: type[M]) -> list[M]:
    """Return the messages of one kind that are broadcast."""
    messages = [getattr(effect, "message", None) for effect in effects if type(effect).__name__ == "Broadcast"]
    return [message for message in messages if isinstance(message, kind)]


def told(effects: list[Effect], index: int, kind: type[M]) -> list[M]:
    """Return the messages of one kind that are sent to one peer."""
    return [
        effect.message  # type: ignore[attr-defined]
        for effect in effects
        if type(effect).__name__ == "SendTo" and effect.index == index and isinstance(effect.message, kind)  # type: ignore[attr-defined]
    ]


def committed(effects: list[Effect]) -> list[Block]:
    """Return the blocks that became final, oldest first."""
    return [block for effect in of_type(effects, CommitBlocks) for block in effect.blocks]
