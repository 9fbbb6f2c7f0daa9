"""What a stranger's definition may ask for: its own messages are read by it, for no more work than they have bytes."""

from __future__ import annotations

import struct
import threading
import time

import pytest

from clients.robot.sources.messages.message_types import (
    DEFINITION_MAX_CHARS,
    DEFINITION_MAX_WORDS,
    LEARNT_MAX_COUNT,
    LearntTypes,
    Message,
    MessageTypes,
    own_types,
)
from clients.robot.synthetic.bag_messages import MessageCodec
from consensus.errors import BlockRobotError

RULE = "=" * 80
TAG = "a_msgs/msg/Tag"
NOTHING = f"{RULE}\nMSG: a_msgs/Nothing\n"
TEN_BYTES = struct.pack("<I", (1 << 32) - 1) + struct.pack("<I", 2) + b"AB"


def doubling(levels: int) -> str:
    """A type that holds two of a type that holds two, and so on, down to nothing."""
    parts = ["string epc\nL0 x\n"]
    parts += [f"MSG: a_msgs/L{n}\nL{n + 1} x\nL{n + 1} y\n" for n in range(levels)]
    return f"{RULE}\n".join([*parts, f"MSG: a_msgs/L{levels}\n"])


UNBOUNDED = {
    "an array of nothing": "Nothing[] x\nstring epc\n" + NOTHING,
    "a long fixed array of nothing": "Nothing[4000] x\nstring epc\n" + NOTHING,
    "an array of what holds nothing but nothing": f"Box[] x\nstring epc\n{RULE}\nMSG: a_msgs/Box\nNothing a\n{NOTHING}",
    "an array in an array's elements": f"Box[] x\nstring epc\n{RULE}\nMSG: a_msgs/Box\nuint8 a\nNothing[] b\n{NOTHING}",
    "an array of arrays of no length": f"Box[] x\nstring epc\n{RULE}\nMSG: a_msgs/Box\nuint8[0] a\n",
    "two of two of two, down to nothing": doubling(30),
    "a fixed array of more texts than anybody writes out": "string[4000000000] x\nstring epc\n",
    "fixed arrays that are long together": "".join(f"string[1000] x{n}\n" for n in range(5)) + "string epc\n",
    "a type that holds itself": f"Box x\nstring epc\n{RULE}\nMSG: a_msgs/Box\nuint8 a\nBox b\n",
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("what", UNBOUNDED)
def test_a_definition_that_asks_for_more_work_than_its_messages_have_bytes_is_as_if_never_told(what: str) -> None:
    types = LearntTypes(own_types(), ros1=True)
    assert types.learn(TAG, UNBOUNDED[what]) is False
    assert not types.of(TAG).knows(TAG)
    assert not types.of(TAG, UNBOUNDED[what]).knows(TAG)
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        types.of(TAG).decode(Message("/rfid", TAG, 0, TEN_BYTES))


@pytest.mark.parametrize("ros1", [True, False])
def test_what_robots_publish_is_not_taken_for_that(ros1: bool) -> None:
    store = MessageCodec().store
    types = MessageTypes(store, ros1=ros1)
    assert [name for name in store.types if not types.knows(name)] == []
    learnt = LearntTypes(own_types(), ros1=True)
    boxes = f"string epc\nBox[] x\n{RULE}\nMSG: a_msgs/Box\nuint8 a\nfloat64[9000] k\nNothing n\n{NOTHING}"
    assert learnt.learn(TAG, boxes)
    assert learnt.of(TAG).decode(Message("/rfid", TAG, 0, b"\2\0\0\0AB" + bytes(4))).epc == "AB"


def test_messages_of_publishers_that_disagree_about_a_type_are_each_read_by_their_own_definition() -> None:
    types = LearntTypes(own_types(), ros1=True)
    texts = {"float32 a\nfloat32 b\n": (2.0, 9.0), "float32 b\nfloat32 a\n": (9.0, 2.0)}
    wrong: list[float] = []

    def read(definition: str, values: tuple[float, float]) -> None:
        for _ in range(500):
            found = types.of(TAG, definition).decode(Message("/rfid", TAG, 0, struct.pack("<ff", *values)))
            wrong.extend([found.a] if found.a != 2.0 else [])

    threads = [threading.Thread(target=read, args=pair) for pair in texts.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_what_strangers_define_takes_no_more_memory_than_so_many_definitions() -> None:
    types = LearntTypes(own_types(), ros1=True)
    good = types.of(TAG, "string epc")
    for number in range(3 * LEARNT_MAX_COUNT):
        types.of(TAG, f"string epc{number}")
        types.learn(f"a_msgs/msg/T{number}", "%%%")
        assert types.of(TAG, "string epc") is good, "what is in use is not forgotten"
    assert types.learn(TAG, "#" * (DEFINITION_MAX_CHARS + 1)) is False
    assert len(types._worked_out) == LEARNT_MAX_COUNT
    assert len(types._newest) == LEARNT_MAX_COUNT
    assert max(len(text) for _, text in types._worked_out) < DEFINITION_MAX_CHARS


@pytest.mark.parametrize(
    "line", ["int8 a{0}\n", "string a{0}\n", "a b{0}\n", "b/c/D[3] a{0}\n", "int32 A{0}=0\n", "#{0}\n", "\n", "a{0} "]
)
def test_a_definition_of_the_largest_length_takes_no_seconds(line: str) -> None:
    types = LearntTypes(own_types(), ros1=True)
    text = "".join(line.format(number) for number in range(DEFINITION_MAX_CHARS // 6))[:DEFINITION_MAX_CHARS]
    words = "int8 a\n" * (DEFINITION_MAX_WORDS // 2)
    before = time.thread_time()
    assert types.learn(TAG, text) in (False, line in ("#{0}\n", "\n"))
    for number in range(5):
        types.learn(TAG, f"{words}# {number}\n")
    assert time.thread_time() - before < 3, "it is of a second or two less on any machine"


def test_another_comment_is_no_other_type() -> None:
    types = LearntTypes(own_types(), ros1=True)
    assert types.of(TAG, "# one\n\nstring epc") is types.of(TAG, "string epc\n  # another\n")
    assert types.of(TAG, 'string A="#"\nstring epc').knows(TAG)
