"""A recording in SQLite may be a program, and what lies in a bag's folder no file: neither is run nor waited for."""

from __future__ import annotations

import os
import resource
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import pytest

from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.salvage import BrokenOffError, scan_sqlite
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import Topic, record, storage_file

STRING = "std_msgs/msg/String"
TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT,type TEXT,serialization_format TEXT,"
    "offered_qos_profiles TEXT)"
)
TOPIC = f"INSERT INTO topics VALUES(1,'/tags','{STRING}','cdr','')"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER,timestamp INTEGER,data BLOB)"
MESSAGE = "INSERT INTO messages(topic_id,timestamp) VALUES(1,1)"
INDEX = "CREATE INDEX timestamp_idx ON messages(timestamp)"
MANY = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i+1 FROM n LIMIT 50) SELECT"
"""A stranger leaves the limit out; with it a reader that runs such a view fails the test and not the machine."""
PAGE = 4096
SCHEMA = ("CREATE TABLE schema(schema_version INTEGER, ros_distro TEXT)", "INSERT INTO schema VALUES(4,'x')")
LARGE = "hex(zeroblob(500000))"
GENERATED = f"{MESSAGES[:-1]} GENERATED ALWAYS AS (zeroblob(9000000)) VIRTUAL)"

PROGRAMS = {
    "topics without end": (
        MESSAGES,
        f"CREATE VIEW topics AS {MANY} i AS id, '/'||i||{LARGE} AS name, '{STRING}' AS type, "
        "'cdr' AS serialization_format, '' AS offered_qos_profiles FROM n",
    ),
    "definitions without end": (
        TOPICS.replace("offered_qos_profiles TEXT", "offered_qos_profiles TEXT, type_description_hash TEXT"),
        MESSAGES,
        *SCHEMA,
        f"CREATE VIEW message_definitions AS {MANY} i AS id, 't'||i AS topic_type, 'ros2msg' AS encoding, "
        f"{LARGE} AS encoded_message_definition, '' AS type_description_hash FROM n",
    ),
    "messages without end": (
        TOPICS,
        TOPIC,
        f"CREATE VIEW messages AS {MANY} i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n",
    ),
    "data that is computed": (TOPICS, TOPIC, GENERATED, INDEX, MESSAGE, MESSAGE, MESSAGE),
    "data that is computed and stored": (
        TOPICS,
        TOPIC,
        f"{MESSAGES[:-1]}, more BLOB AS (zeroblob(5)) STORED)",
        INDEX,
        MESSAGE,
    ),
    "data that a row leaves out": (TOPICS, TOPIC, f"{MESSAGES[:-1]} DEFAULT 7)", INDEX, MESSAGE),
    "an index of what is computed": (TOPICS, TOPIC, MESSAGES, "CREATE INDEX i ON messages(abs(timestamp))", MESSAGE),
    "a trigger": (
        TOPICS,
        TOPIC,
        MESSAGES,
        INDEX,
        MESSAGE,
        "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    ),
    "a virtual table": (TOPICS, TOPIC, MESSAGES, INDEX, MESSAGE, "CREATE VIRTUAL TABLE metadata USING fts5(a)"),
    "a table of another name": (TOPICS, TOPIC, MESSAGES, INDEX, MESSAGE, "CREATE TABLE other(a)"),
}


def make(path: Path, *statements: str) -> Path:
    with closing(sqlite3.connect(path)) as base, base:
        for statement in statements:
            base.execute(statement)
    return path


@pytest.mark.parametrize("what", PROGRAMS)
def test_a_database_that_computes_what_it_holds_is_not_read(tmp_path: Path, what: str) -> None:
    path = make(tmp_path / "a.db3", *PROGRAMS[what])
    with pytest.raises(BrokenOffError, match="no recorder wrote it"):
        list(scan_sqlite(path))
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        Recording(path)


@pytest.mark.parametrize("of", [b"timestamp_idx ON", b"offered_qos_profiles", b"/tags", b"std_msgs/msg"])
def test_a_database_whose_texts_are_no_unicode_is_damaged(tmp_path: Path, of: bytes) -> None:
    path = make(tmp_path / "a.db3", TOPICS, TOPIC, MESSAGES, INDEX, MESSAGE)
    path.write_bytes(path.read_bytes().replace(of, b"\xff" + of[1:]))
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        Recording(path)


@pytest.mark.parametrize("statements", [(), (INDEX,)], ids=["unindexed", "indexed"])
def test_what_recorders_write_is_read(tmp_path: Path, statements: tuple[str, ...]) -> None:
    rows = [f"INSERT INTO messages(topic_id,timestamp,data) VALUES(1,{at},x'00')" for at in (1, 2)]
    path = make(tmp_path / "a%2Fb?c.db3", TOPICS, TOPIC, MESSAGES, *statements, *rows, "ANALYZE")
    assert [message.at_ns for message in Recording(path).messages(["/tags"])] == [1, 2]


def test_no_name_in_a_folder_leads_out_of_it(tmp_path: Path) -> None:
    """The library writes a file's name into an address as it is."""
    folder = record(tmp_path / "bag", "sqlite3", [Topic("/tags", STRING, [(0, {"data": "E1"})])])
    (tmp_path / "other").mkdir()
    storage_file(folder).rename(tmp_path / "other" / "secret.db3")
    lead = "..%2Fother%2Fsecret.db3"
    (folder / lead).write_bytes(b"")
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("bag.db3", lead))
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        Recording(folder)


def many_times(path: Path, levels: int) -> None:
    """Put so many levels of pages above the only page of the messages, each of which leads 300 times to the next."""
    with closing(sqlite3.connect(path)) as base:
        ((root,),) = base.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'")
    pages = bytearray(path.read_bytes())
    place = slice((root - 1) * PAGE, root * PAGE)
    leaf, next_page = bytes(pages[place]), len(pages) // PAGE + 1

    def leading_to(page: int) -> bytes:
        cell = struct.pack(">IB", page, 1)
        begin = PAGE - 300 * len(cell)
        head = struct.pack(">BHHHBI", 5, 0, 300, begin, 0, page)
        return (head + b"".join(struct.pack(">H", begin + 5 * n) for n in range(300))).ljust(begin, b"\0") + cell * 300

    pages[place] = leading_to(next_page)
    for level in range(1, levels):
        pages += leading_to(next_page + level)
    pages += leaf
    pages[28:32] = struct.pack(">I", len(pages) // PAGE)
    path.write_bytes(pages)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("indexed", [(), (INDEX,)], ids=["unindexed", "indexed"])
def test_pages_that_lead_to_the_same_page_again_and_again_come_to_an_end(
    tmp_path: Path, indexed: tuple[str, ...]
) -> None:
    """Eighteen levels: 10^44 rows in 100 KB."""
    row = "INSERT INTO messages(topic_id,timestamp,data) VALUES(1,1,x'00')"
    path = make(tmp_path / "a.db3", f"PRAGMA page_size={PAGE}", TOPICS, TOPIC, MESSAGES, *indexed, row)
    many_times(path, 18)
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        for _ in Recording(path).messages(["/tags"]):
            pass
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_utime - before.ru_utime < 20
    assert after.ru_maxrss - before.ru_maxrss < 200 * 1024


def test_rows_that_share_their_pages_give_out_no_more_than_some_times_the_file(tmp_path: Path) -> None:
    row = "INSERT INTO messages(topic_id,timestamp,data) VALUES(1,1,zeroblob(1000000))"
    path = make(tmp_path / "a.db3", f"PRAGMA page_size={PAGE}", TOPICS, TOPIC, MESSAGES, row)
    many_times(path, 1)
    taken: list[int] = []
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        taken.extend(len(message.data) for message in Recording(path).messages(["/tags"]))
    assert 0 < sum(taken) < 5 * path.stat().st_size


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "metadata.yaml", "other"])
def test_a_folder_that_holds_a_pipe_is_refused_at_once(tmp_path: Path, name: str) -> None:
    folder = record(tmp_path / "bag", "mcap", [Topic("/tags", STRING, [(0, {"data": "E1"})])])
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    with pytest.raises(BlockRobotError, match=f"BAG_DAMAGED: {name} is no regular file"):
        Recording(folder)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.bag", "a.bag.active"])
def test_a_pipe_in_place_of_a_recording_is_refused_at_once(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        Recording(tmp_path / name)
