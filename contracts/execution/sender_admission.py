"""Mempool admission from finalized state alone.

Admitted: active members, visits' deciding keys, grantees, office keys, producers, candidates and valid registrations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.members.vouchers import CARD_TAG, VOUCHER_TAG
from consensus.primitives.encoding import EXACT_INTEGER_END, u64
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.primitives.keys import recover
from consensus.state.access import GrantRow, grant_of
from consensus.state.identity import HANDLE, MEMBER, REGISTRAR, active_role, handle_of, is_registered, office_of
from consensus.state.keys import Reader
from consensus.state.producers import is_candidate
from consensus.state.records import VISIT, decided_root
from contracts.state.view import StateReader

OWNER_ENTRIES_OF_RECORDS = frozenset({"transfer"})
GRANTEE_ENTRIES = frozenset({"request_granted", "noticed"})
PRODUCER_ENTRIES = frozenset({"ready", "accuse"})
NOT_ADMITTED = "SENDER_NOT_ADMITTED"
_REGISTER_ARGUMENTS_COUNT = 10
_RECOVERED_KEPT_COUNT = 256


def _owns_visit(state: Reader, owner: bytes) -> bool:
    return decided_root(state, owner) is not None


def _named_grant(state: Reader, transaction: Transaction, now_ms: int) -> GrantRow | None:
    body = transaction.body
    if body.contract != "access" or body.entry not in GRANTEE_ENTRIES:
        return None
    try:
        arguments = transaction.arguments()
    except BlockRobotError:
        return None
    grant_id = arguments[0] if arguments else None
    return grant_of(state, grant_id, body.sender, now_ms) if isinstance(grant_id, bytes) else None


def _is_grantees_matter(state: Reader, transaction: Transaction, now_ms: int) -> bool:
    grant = _named_grant(state, transaction, now_ms)
    return grant is not None and (transaction.body.entry == "noticed" or now_ms < grant.ended_ms)


def name_grantees(owner: bytes) -> str:
    return f"grantees of visit {owner.hex()}"


@dataclass(frozen=True, slots=True)
class Account:
    """The account of queued transactions, unaffected by key changes. Its name tells an operator whose it is.

    `is_of_visit`: a visit's; `origin`: its robot, sharing visit limits; `is_shared`: used by many keys.
    """

    name: str
    is_of_visit: bool = False
    origin: str = ""
    is_shared: bool = False

    def name_payer(self, sender: bytes) -> str:
        """Return the account whatever its key, or the one of the keys that share it."""
        return f"grantee {sender.hex()}" if self.is_shared else self.name


def name_key(state: Reader, key: bytes) -> str:
    """Return whose key it is, for each kind in words of its own: handles are whatever a registrar draws."""
    member = MEMBER.at(state, key)
    if member is not None and member.is_active:
        return _name_member(member.handle)
    office = office_of(state, key)
    if office is not None:
        return " of ".join(office)
    root = None if is_candidate(state, key) else decided_root(state, key)
    return f"key {key.hex()}" if root is None else _name_visit(root)


def _name_member(handle: bytes) -> str:
    return f"member {handle.hex()}"


def _name_visit(root: bytes) -> str:
    return f"visit {root.hex()}"


def _name_origin(state: Reader, root: bytes) -> str:
    visit = VISIT.at(state, root)
    robot = b"" if visit is None else visit.robot
    return f"visits of {(handle_of(state, robot) or robot).hex()}"


def _name_newcomer(transaction: Transaction) -> str:
    """Count by handle: one card signs many registrations."""
    try:
        handle = transaction.arguments()[0]
    except (BlockRobotError, IndexError):
        return ""
    return _name_member(handle) if isinstance(handle, bytes) and len(handle) == HASH_SIZE_BYTES else ""


def find_account(state: Reader, transaction: Transaction) -> Account:
    grant = _named_grant(state, transaction, 0)
    if grant is not None:
        origin = _name_origin(state, grant.owner)
        return Account(name_grantees(grant.owner), is_of_visit=True, origin=origin, is_shared=True)
    sender = transaction.body.sender
    # A robot may open a visit under anybody's key, which makes nobody else a visit's owner.
    is_other = is_registered(state, sender) or _has_office(state, sender) or is_candidate(state, sender)
    root = None if is_other else decided_root(state, sender)
    if root is not None:
        return Account(_name_visit(root), is_of_visit=True, origin=_name_origin(state, root))
    newcomer = "" if is_other or not is_registration(transaction) else _name_newcomer(transaction)
    return Account(newcomer or name_key(state, sender))


_OWN_MATTERS: dict[str, Callable[[Reader, bytes], bool]] = {
    "access": _owns_visit,
    "consent": is_registered,
    "erasure": _owns_visit,
    "records": _owns_visit,
    "rights": lambda state, sender: _owns_visit(state, sender) or is_registered(state, sender),
}
"""Calls about oneself, and who may have them wait whatever their role."""


def _is_self_service_call(state: Reader, sender: bytes, contract: str, entry: str) -> bool:
    if contract == "records" and entry not in OWNER_ENTRIES_OF_RECORDS:
        return False
    return contract in _OWN_MATTERS and _OWN_MATTERS[contract](state, sender)


def _has_office(state: Reader, sender: bytes) -> bool:
    return office_of(state, sender) is not None


@lru_cache(maxsize=_RECOVERED_KEPT_COUNT)
def _recovers(tag: str, signature: Any, message: bytes) -> bytes | None:
    try:
        return recover(tag, signature, message)
    except BlockRobotError:
        return None


def _find_registration_fault(state: StateReader, transaction: Transaction, chain_time_ms: int) -> str:
    """Return an error code or empty; elliptic-curve checks come last, registrar's first."""
    arguments = transaction.arguments()
    if len(arguments) != _REGISTER_ARGUMENTS_COUNT:
        return NOT_ADMITTED
    handle, card_key, role, not_after_ms, voucher_signature, spend, view, sealing, card_signature, _ = arguments
    texts = (handle, card_key, voucher_signature, spend, view, sealing, card_signature)
    well_formed = all(isinstance(item, bytes) for item in texts) and isinstance(role, str) and len(handle) == 32
    if not well_formed or type(not_after_ms) is not int or not 0 <= not_after_ms < EXACT_INTEGER_END:
        return NOT_ADMITTED
    chain_id, sender = transaction.body.chain_id, transaction.body.sender
    if HANDLE.has(state, handle):
        return "HANDLE_TAKEN"
    if chain_time_ms > not_after_ms:
        return "VOUCHER_EXPIRED"
    voucher = chain_id + handle + card_key + u64(not_after_ms) + role.encode()
    registrar = _recovers(VOUCHER_TAG, voucher_signature, voucher)
    if registrar is None or not REGISTRAR.has(state, registrar):
        return "VOUCHER_FOREIGN"
    card = chain_id + handle + sender + spend + view + sealing
    return "" if _recovers(CARD_TAG, card_signature, card) == card_key else "VOUCHER_FOREIGN"


def is_registration(transaction: Transaction) -> bool:
    return transaction.body.contract == "identity" and transaction.body.entry == "register"


def find_admission_error(state: StateReader, transaction: Transaction, chain_time_ms: int) -> str:
    """Return an error code, or empty if admitted, by finalized state and time (ms).

    Callers verify the sender; only registrations cost elliptic-curve operations.
    """
    sender, body = transaction.body.sender, transaction.body
    if active_role(state, sender):
        return ""
    is_own = _is_self_service_call(state, sender, body.contract, body.entry)
    if is_own or _is_grantees_matter(state, transaction, chain_time_ms):
        return ""
    if _has_office(state, sender):
        return ""
    if body.contract == "producers" and body.entry in PRODUCER_ENTRIES and is_candidate(state, sender):
        return ""
    if is_registration(transaction):
        return _find_registration_fault(state, transaction, chain_time_ms)
    return NOT_ADMITTED


def is_admitted(state: StateReader, transaction: Transaction, chain_time_ms: int) -> bool:
    return not find_admission_error(state, transaction, chain_time_ms)


def require_admission(state: StateReader, transaction: Transaction, chain_time_ms: int) -> None:
    """Require admission. Raises SENDER_NOT_ADMITTED, VOUCHER_FOREIGN, VOUCHER_EXPIRED or HANDLE_TAKEN."""
    fault = find_admission_error(state, transaction, chain_time_ms)
    if fault:
        raise BlockRobotError(fault)
