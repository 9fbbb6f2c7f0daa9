"""Searches a network for remains of records: what, where and until when.

A MongoDB server's own files are searched only where they are named.
"""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from network.cluster import Cluster
from network.custody.searching import Search
from network.custody.traces import Trace, mongo_documents, trace_chain, trace_grants, trace_store
from node.clips_place import ClipsPlace
from node.config import NodeConfig
from node.custody.stores.open_store import MONGO_SCHEMES, open_blobs
from node.storage.lmdb_reader import LedgerFile

OnProgress = Callable[[str], None]

_UNTIL_PRUNED = (
    "what the chain says of it, until its blocks are dropped (an archive never does) and their pages used again"
)
_UNTIL_CUT = "blocks that the node voted on, until its journal is cut"
_UNTIL_NEXT_SNAPSHOT = "the chain's state at an older block, until the next snapshot takes its place"
_ON_CHAIN = frozenset({"id", "root", "metadata"})
_WHILE_KEPT = "the record is kept"
_MARK = (
    "its id alone: the mark that it was erased, so that it is never kept again; and requests and shares that named it"
)
_ALARM = "a line that tells of a fault, until the log is removed"

_PLACES = (("ledger", "ledger"), ("journal", "journal"), ("snapshots", "snapshots"), ("snapshots.fetched", "snapshots"))
_LOGS = frozenset({"node.log", "output.log"})


@dataclass(frozen=True, slots=True)
class Finding:
    """Part of a record in one place; `why` it is allowed, empty if forbidden."""

    record_id: bytes
    place: str
    what: str
    count: int
    why: str


@dataclass(slots=True)
class HuntReport:
    """All findings, and what was searched for and where."""

    traces: list[Trace]
    findings: list[Finding] = field(default_factory=list)
    files_count: int = 0
    documents_count: int = 0
    size_bytes: int = 0
    unread: list[str] = field(default_factory=list)

    @property
    def forbidden(self) -> list[Finding]:
        return [finding for finding in self.findings if not finding.why]

    @property
    def not_compared(self) -> list[Trace]:
        return [trace for trace in self.traces if not trace.is_compared]

    @property
    def is_clean(self) -> bool:
        return not self.forbidden and not self.unread and not self.not_compared

    @property
    def searched_for(self) -> Counter[str]:
        """Pieces by kind."""
        counts: Counter[str] = Counter()
        for trace in self.traces:
            counts.update({kind: len(pieces) for kind, pieces in trace.pieces.items()})
        return counts


def place_of(relative: Path) -> str:
    parts = relative.parts
    if len(parts) >= 3 and parts[0] == "nodes":
        if parts[2] in _LOGS:
            return "log"
        if parts[2] == "custody":
            return "store"
        if parts[2] == "erase-keys":
            return "erase-keys"
        return next((kind for name, kind in _PLACES if parts[2] == name), "other")
    return "other"


def explain(place: str, what: str, *, is_gone: bool) -> str:
    """Why part of a record may be in a place; empty if forbidden."""
    if what in _ON_CHAIN and place in {"ledger", "journal"}:
        return _UNTIL_PRUNED if place == "ledger" else _UNTIL_CUT
    if what in _ON_CHAIN and place == "snapshots":
        return _UNTIL_NEXT_SNAPSHOT
    if what == "id" and place == "log":
        return _ALARM
    if is_gone:
        return _MARK if (what, place) == ("id", "store") else ""
    if place == "store":
        return _WHILE_KEPT if what in {"id", "leaf", "root", "ciphertext", "wrapped-key", "wrapped-part"} else ""
    return _WHILE_KEPT if (place, what) == ("erase-keys", "erase-key") else ""


def _custodians(cluster: Cluster) -> list[NodeConfig]:
    return [config for config in cluster.configs.values() if config.custodian_key_path is not None]


def gather(cluster: Cluster, record_ids: Sequence[bytes], known: Sequence[Trace] = ()) -> list[Trace]:
    """From every ledger and store, with those already known. Raises NOT_FOUND for a record without ledger entry or traces,
    STORE_UNAVAILABLE, STORAGE_*.
    """
    remembered = {trace.record_id: trace for trace in known}
    traces = [
        Trace(each, pieces=remembered[each].pieces, grants=remembered[each].grants)
        if each in remembered
        else Trace(each)
        for each in record_ids
    ]
    for config in cluster.configs.values():
        with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as snapshot:
            for trace in traces:
                trace_chain(trace, snapshot)
    for trace in traces:
        if trace.status == "unknown" and trace.record_id not in remembered:
            raise BlockRobotError("NOT_FOUND", f"No node's chain knows a record {trace.record_id.hex()}.")
        for config in _custodians(cluster):
            trace_store(trace, config)
        if "leaf" in trace.pieces:
            trace.pieces["leaf"] -= trace.pieces.get("root", set())  # of a clip of one frame they are the same
    for config in cluster.configs.values():
        with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as snapshot:
            for trace in traces:
                trace_grants(trace, snapshot)
    return traces


class _Tally:
    """Findings, grouped by record."""

    def __init__(self, traces: Sequence[Trace]) -> None:
        self.owners: dict[bytes, list[tuple[Trace, str, bool]]] = {}
        for trace in traces:
            for kind, pieces in trace.pieces.items():
                for piece in pieces:
                    for form in (piece, piece.hex().encode()):
                        self.owners.setdefault(form, []).append((trace, kind, trace.is_over(piece)))
        self.search = Search(self.owners)

    def findings(self, place: str, kind: str, found: Counter[bytes]) -> Iterator[Finding]:
        counts: Counter[tuple[bytes, str, bool]] = Counter()
        for form, count in found.items():
            for trace, what, is_over in self.owners[form]:
                counts[trace.record_id, what, is_over] += count
        for (record_id, what, is_over), count in sorted(counts.items()):
            yield Finding(record_id, place, what, count, explain(kind, what, is_gone=is_over))


def hunt(
    cluster: Cluster, traces: Sequence[Trace], also: Sequence[Path] = (), on_progress: OnProgress = lambda _text: None
) -> HuntReport:
    """`also`: paths beside the network."""
    report, tally = HuntReport(list(traces)), _Tally(traces)
    clips = [place.folder.resolve() for place in _clips_of(cluster) if place.folder is not None]
    apart = [folder for folder in clips if not folder.is_relative_to(cluster.folder)]
    own = files_below(cluster.folder, report.unread)
    places = [(path, _place_or_clips(path, place_of(path.relative_to(cluster.folder)), clips)) for path in own]
    places += [(path, "store") for each in apart for path in files_below(each, report.unread)]
    places += [(path, "other") for each in also for path in files_below(each, report.unread)]
    for path, kind in places:
        on_progress(str(path))
        try:
            size = path.stat().st_size
            found = tally.search.in_file(path)
        except FileNotFoundError:
            continue
        except OSError as error:
            report.unread.append(f"{path}: {error.strerror}")
            continue
        report.files_count += 1
        report.size_bytes += size
        name = path.relative_to(cluster.folder) if path.is_relative_to(cluster.folder) else path
        report.findings += tally.findings(str(name), kind, found)
    for config in _custodians(cluster):
        if config.custody_store.startswith(MONGO_SCHEMES):
            on_progress(f"the database of {config.name}")
            _hunt_documents(config, tally, report)
    for place in _clips_of(cluster):
        if place.bucket:
            on_progress(f"the bucket {place.bucket}")
            asyncio.run(_hunt_bucket(place, tally, report))
    return report


def _clips_of(cluster: Cluster) -> list[ClipsPlace]:
    return [config.clips for config in _custodians(cluster) if config.clips is not None]


def _place_or_clips(path: Path, place: str, clips: Sequence[Path]) -> str:
    return "store" if any(path.is_relative_to(folder) for folder in clips) else place


async def _hunt_bucket(place: ClipsPlace, tally: _Tally, report: HuntReport) -> None:
    """What the server gives out; not what its volumes still hold."""
    found: Counter[bytes] = Counter()
    try:
        async with open_blobs(place) as blobs:
            async for name in blobs.names():
                content = name.encode() + b"\0" + (await blobs.get(name, CLIP_SIZE_MAX_BYTES) or b"")
                report.documents_count += 1
                report.size_bytes += len(content)
                found.update(tally.search.in_bytes(content))
    except BlockRobotError as error:
        report.unread.append(f"the bucket {place.bucket}: {error.detail}")
    report.findings += tally.findings(f"bucket {place.bucket}", "store", found)


def _hunt_documents(config: NodeConfig, tally: _Tally, report: HuntReport) -> None:
    found: dict[str, Counter[bytes]] = {}
    try:
        for collection, content in mongo_documents(config):
            report.documents_count += 1
            report.size_bytes += len(content)
            found.setdefault(collection, Counter()).update(tally.search.in_bytes(content))
    except BlockRobotError as error:
        report.unread.append(f"the database of {config.name}: {error.detail}")
    for collection, counts in found.items():
        report.findings += tally.findings(f"database of {config.name}, {collection}", "store", counts)


def files_below(place: Path, unread: list[str]) -> Iterator[Path]:
    """In order, following links, each folder once; failures go to `unread`."""
    if place.is_file():
        yield place
        return
    seen: set[tuple[int, int]] = set()

    def fail(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError) or error.filename == str(place):  # others went away meanwhile
            unread.append(f"{error.filename}: {error.strerror}")

    for folder, folders, names in os.walk(place, onerror=fail, followlinks=True):
        try:
            about = Path(folder).stat()
        except OSError as error:
            fail(error)
            continue
        if (about.st_dev, about.st_ino) in seen:
            folders.clear()
            continue
        seen.add((about.st_dev, about.st_ino))
        folders.sort()
        for path in (Path(folder, name) for name in sorted(names)):
            if path.is_symlink() and not path.exists():
                unread.append(f"{path}: its link leads nowhere")
            elif path.is_file():
                yield path
