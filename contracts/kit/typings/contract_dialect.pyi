"""What a contract can name besides Python's own: for editors and type checkers. Python never imports this."""

from collections.abc import Callable
from typing import Any, TypeVar, overload

_F = TypeVar("_F", bound=Callable[..., Any])
_Key = bytes
_Value = Any

def export(function: _F) -> _F:
    """An entry that transactions and other contracts may call."""

def view(function: _F) -> _F:
    """An entry that only reads."""

def genesis(function: _F) -> _F:
    """An entry that runs only while the genesis block is made."""

def migrate(function: _F) -> _F:
    """The entry that the machine runs once when this version of the contract is activated."""

class _Context:
    @property
    def caller(self) -> bytes:
        """The 33-byte key that signed the transaction."""
    @property
    def height(self) -> int:
        """The block's height."""
    @property
    def time(self) -> int:
        """The block's time in milliseconds since 1970 UTC."""
    @property
    def txid(self) -> bytes:
        """The transaction's id, 32 bytes."""
    @property
    def chain(self) -> bytes:
        """The chain's id, 32 bytes."""
    @property
    def contract(self) -> str:
        """This contract's name."""
    @property
    def calling_contract(self) -> str:
        """The contract that called this one; an empty text when a transaction did."""

class _State:
    @overload
    def get(self, key: _Key) -> _Value: ...
    @overload
    def get(self, key: _Key, default: _Value) -> _Value:
        """A copy of the value under a key of 1 to 128 bytes, or the default."""
    def has(self, key: _Key) -> bool:
        """Whether there is a value under the key."""
    def put(self, key: _Key, value: _Value) -> None:
        """Store a value of at most 16 KiB encoded."""
    def delete(self, key: _Key) -> None:
        """Remove the value under the key; nothing happens if there is none."""
    def scan(self, prefix: bytes, limit: int) -> list[Any]:
        """Up to `limit` (1 to 256) [key, value] pairs in key order."""

ctx: _Context
state: _State

def emit(name: str, data: dict[Any, Any]) -> None:
    """Tell an event."""

def call(contract: str, fn: str, *arguments: _Value) -> _Value:
    """The result of another contract's export or view."""

def require(condition: object, code: str, message: str = ...) -> None:
    """Fail the whole call with an UPPER_SNAKE code if the condition does not hold."""

def sha256(data: bytes) -> bytes:
    """The SHA-256 of bytes, 32 bytes."""

def tagged_hash(tag: str, data: bytes) -> bytes:
    """SHA-256 over SHA-256(tag) twice and the data, 32 bytes."""

def recover(tag: str, signature: bytes, message: bytes) -> bytes | Any:
    """The 33-byte key that made a 65-byte signature over the tagged hash, or None.

    `Any` stands for None: type checkers do not see that `require(key is not None, ...)` rules it out.
    """

def u32(number: int) -> bytes:
    """Four bytes, big-endian."""

def u64(number: int) -> bytes:
    """Eight bytes, big-endian, so that keys sort as numbers do."""
