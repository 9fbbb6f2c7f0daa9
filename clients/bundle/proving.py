"""From a bundle's proofs to its contents, shared by exporter and verifier."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from clients.bundle import document_building, layout
from clients.bundle import documents as doc
from clients.bundle.checks.chain_proofs import ProvedChain, ProvedReceipt
from clients.bundle.checks.consent_receipts import CheckedReceipt
from clients.bundle.checks.frame_check import FrameSource, Piece, walk_frames
from clients.bundle.checks.key_history import prove_sealing_keys
from clients.bundle.checks.signed_receipts import build_signed_receipts, prove_signed, require_proved_consents
from clients.bundle.checks.visit_check import VisitFacts, read_visit
from clients.bundle.texts import README_TEXT, player_page
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256

SIGN_TAG = "blockrobot/export"
Heard = Callable[[str, int, int], None]
"""What is being done, and how much of how much is done."""


@dataclass(frozen=True, slots=True)
class Proofs:
    """Documents under proofs/; None: `person` left out, `keys` unchanged, `signed` without receipts."""

    chain: doc.ChainProofs
    person: doc.StateProofs | None
    visits: tuple[doc.StateProofs, ...]
    receipts: doc.ReceiptProofs
    openings: doc.RecordOpenings
    keys: doc.KeyHistory | None = None
    signed: doc.SignedReceipts | None = None

    @property
    def version(self) -> int:
        is_plain = self.keys is None and self.signed is None
        return doc.FORMAT_VERSION if is_plain else doc.FORMAT_VERSION_EXTENDED


@dataclass(frozen=True, slots=True)
class Proven:
    """What follows from the proofs, except frames."""

    chain: ProvedChain
    consents: doc.ConsentsDocument
    visits: tuple[VisitFacts, ...]
    texts: document_building.Texts
    signers: tuple[bytes, ...]
    """Whose signatures the bundle has to have: the visits' owner keys, in order, and the member key."""
    signed: tuple[CheckedReceipt, ...]
    told_receipts: doc.SignedReceiptsDocument | None
    custodian_names: dict[str, str]
    """What the genesis file calls custodians, by their keys; those that joined later have no name in a bundle."""


def schema_text(version: int) -> bytes:
    return resources.files("clients.bundle").joinpath(f"schema_v{version}.json").read_bytes()


def prove(genesis: Genesis, proofs: Proofs) -> Proven:
    """Check all but frames. Raises BUNDLE_INVALID, BUNDLE_UNPROVEN, PROOF_*, CERTIFICATE_INVALID, ENCODING_*."""
    chain = ProvedChain(genesis, proofs.chain.epochs)
    receipts = [chain.receipt(layout.CONSENT_PROOFS, proof) for proof in proofs.receipts.receipts]
    consents, sealing, member, signed = _prove_person(chain, genesis, proofs, receipts)
    openings = {doc.read_bytes(layout.RECORD_OPENINGS, row.record_id): row for row in proofs.openings.records}
    visits = tuple(
        read_visit(chain.state(layout.state_proofs_name(number), proof), openings, sealing)
        for number, proof in enumerate(proofs.visits, 1)
    )
    order = [(facts.state.sequence, facts.owner) for facts in visits]
    if order != sorted(set(order)):
        raise BlockRobotError("BUNDLE_INVALID", "The visits are not in the order of the chain.")
    opened = [record.opening for facts in visits for record in facts.records if record.opening is not None]
    if opened != proofs.openings.records:
        raise BlockRobotError("BUNDLE_INVALID", "The bundle opens records that it does not tell of, or not in order.")
    signers = [facts.decided_by for facts in visits] + ([member] if member else [])
    texts = document_building.open_corrections(visits, proofs.openings.corrections)
    if texts and not member:
        raise BlockRobotError("BUNDLE_INVALID", "The bundle opens corrections without saying whose.")
    built = None if proofs.signed is None else build_signed_receipts(proofs.signed, signed)
    names = {node.custodian_key.hex(): f"{node.name} of {node.organisation}" for node in genesis.custodians}
    return Proven(chain, consents, visits, texts, tuple(signers), signed, built, names)


def _prove_person(
    chain: ProvedChain, genesis: Genesis, proofs: Proofs, receipts: Sequence[ProvedReceipt]
) -> tuple[doc.ConsentsDocument, tuple[bytes, ...], bytes, tuple[CheckedReceipt, ...]]:
    if proofs.person is None:
        if receipts or proofs.keys is not None or proofs.signed is not None:
            raise BlockRobotError(
                "BUNDLE_INVALID", "The bundle holds receipts of consent or keys without saying whose."
            )
        return document_building.NO_PERSON, (), b"", ()
    proved = chain.state(layout.state_proofs_name(0), proofs.person)
    member, row = document_building.read_person(proved)
    sealing: tuple[bytes, ...] = (row.sealing,)
    if proofs.keys is not None:
        sealing = prove_sealing_keys(chain, genesis, proofs.keys, member, row)
    signed = () if proofs.signed is None else prove_signed(chain, genesis, proofs.signed, row)
    consents = document_building.build_consents(proved, receipts, {each.statement.member for each in signed})
    if proofs.signed is not None:
        require_proved_consents(proofs.signed, signed, consents)
    return consents, sealing, member, signed


def walk_visits(
    proven: Proven, source: FrameSource, heard: Heard
) -> Generator[Piece, None, tuple[doc.VisitDocument, ...]]:
    """Yield frame files in order; return visit documents."""
    seen: set[bytes] = set()
    built: list[doc.VisitDocument] = []
    done, of = 0, sum(len(facts.records) for facts in proven.visits)
    for number, facts in enumerate(proven.visits, 1):
        frames: list[list[doc.FrameDocument]] = []
        for place, record in enumerate(facts.records, 1):
            shown: list[doc.FrameDocument] = []
            if record.opening is not None:
                shown = yield from walk_frames(number, place, record.opening, record.state, source, seen)
            frames.append(shown)
            done += 1
            heard("records", done, of)
        built.append(document_building.build_visit(number, facts, frames))
    return tuple(built)


def build_documents(proven: Proven, visits: Sequence[doc.VisitDocument]) -> list[tuple[str, bytes]]:
    erasures = document_building.build_erasures(proven.visits)
    parts: list[tuple[str, doc.Document]] = [
        (layout.VISITS, doc.VisitsDocument(list(visits))),
        (layout.AUDIT, document_building.build_audit_trail(proven.visits)),
        (layout.ACCESS, document_building.build_access_log(proven.visits)),
        (layout.ERASURES, erasures),
        (layout.RIGHTS, document_building.build_rights(proven.visits, proven.texts)),
        (layout.CONSENTS, proven.consents),
    ]
    if proven.told_receipts is not None:
        parts.append((layout.TOLD_RECEIPTS, proven.told_receipts))
    return [
        (layout.PLAYER, player_page(visits, erasures.erasures, proven.custodian_names)),
        *((name, doc.write_document(part)) for name, part in parts),
    ]


def proof_files(proofs: Proofs) -> list[tuple[str, bytes]]:
    parts: list[tuple[str, doc.Document]] = [(layout.CHAIN_PROOFS, proofs.chain)]
    if proofs.person is not None:
        parts.append((layout.state_proofs_name(0), proofs.person))
    parts += [(layout.state_proofs_name(number), proof) for number, proof in enumerate(proofs.visits, 1)]
    parts += [(layout.CONSENT_PROOFS, proofs.receipts), (layout.RECORD_OPENINGS, proofs.openings)]
    if proofs.keys is not None:
        parts.append((layout.KEY_HISTORY, proofs.keys))
    if proofs.signed is not None:
        parts.append((layout.SIGNED_RECEIPTS, proofs.signed))
    return [(name, doc.write_document(part)) for name, part in parts]


def fixed_files(genesis_text: bytes, version: int) -> list[tuple[str, bytes]]:
    return [(layout.GENESIS, genesis_text), (layout.SCHEMA, schema_text(version))]


def first_files() -> list[tuple[str, bytes]]:
    return [(layout.README, README_TEXT.encode())]


def sign_parts(chain_id: bytes, manifest: bytes) -> tuple[bytes, bytes]:
    """Return what the owner keys and member key sign, under SIGN_TAG."""
    return chain_id, sha256(manifest)


def never_heard(_what: str, _done: int, _of: int) -> None: ...


def known_form(error: Exception) -> Any:
    return BlockRobotError("BUNDLE_UNPROVEN", f"The state has a form that this version does not know ({error!r:.80}).")
