"""A plan is read whole, with its random steps drawn, or refused with the line that is wrong."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from network.faults.actions import FillDisk, GoByzantine, Heal, Kill, Partition, Pause, Restart, Resume, SetLink, Skew
from network.faults.plan import RANDOM_KINDS, parse_plan
from node.p2p.link_faults import LinkFault

NAMES = ("node-1", "node-2", "node-3", "node-4")

EVERYTHING = """
seed = 7

[[step]]
at = "2s"
do = "partition"
groups = "node-1,node-2 | node-3,node-4"

[[step]]
at = "1s"
do = "kill"
node = "node-2"

[[step]]
at = "3s"
do = "heal"

[[step]]
at = "3500ms"
do = "heal"
node = "node-3"

[[step]]
at = "4s"
do = "link"
link = "node-1 -> node-2"
profile = "wan"
loss = 0.5

[[step]]
at = "5s"
do = "skew"
node = "node-1"
offset = "-1h"

[[step]]
at = "6s"
do = "disk"
node = "node-1"
disk = "ledger"

[[step]]
at = "7s"
do = "byzantine"
node = "node-4"
behaviour = "equivocate"
seed = 3

[[step]]
at = "8s"
do = "pause"
node = "node-3"

[[step]]
at = "9s"
do = "resume"
node = "node-3"

[[step]]
at = "10s"
do = "restart"
node = "node-2"
"""

RANDOM = """
seed = {seed}
[[random]]
from = "0"
to = "60s"
every = "2s"
lasting = "1s"
do = {kinds}
"""


def test_steps_are_read_in_order_of_time_with_their_lines() -> None:
    plan = parse_plan(EVERYTHING, NAMES)
    assert plan.seed == 7
    assert [(step.at_ms, step.line) for step in plan.steps[:3]] == [(1_000, 9), (2_000, 4), (3_000, 14)]
    assert [step.action for step in plan.steps] == [
        Kill("node-2"),
        Partition((("node-1", "node-2"), ("node-3", "node-4"))),
        Heal(),
        Heal(("node-3",)),
        SetLink("node-1", "node-2", LinkFault(40, 10, 0.5, 6_250_000)),
        Skew("node-1", -3_600_000),
        FillDisk("node-1", "ledger"),
        GoByzantine("node-4", "equivocate", 3),
        Pause("node-3"),
        Resume("node-3"),
        Restart("node-2"),
    ]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", 1, "nothing to do"),
        ("seed = 1\nspeed = 2", 2, "speed"),
        ("seed = -1", 1, "seed"),
        ("seed = true", 1, "seed"),
        (f"seed = {1 << 32}", 1, "seed"),
        ("seed = 1\n[[step]", 2, "TOML"),
        ("[[step]]\ndo = 'kill'\nnode = 'node-1'", 1, "at"),
        ("[[step]]\nat = 5\ndo = 'kill'", 2, "at"),
        ("[[step]]\nat = '5'\ndo = 'kill'", 2, "duration"),
        ("[[step]]\nat = '-5s'\ndo = 'kill'", 2, "between"),
        ("[[step]]\nat = '5s'\ndo = 'explode'", 3, "do is one of"),
        ("[[step]]\nat = '5s'\ndo = 'kill'", 1, "node"),
        ("[[step]]\nat = '5s'\ndo = 'kill'\nnode = 'node-9'", 4, "node-9"),
        ("[[step]]\nat = '5s'\ndo = 'kill'\nnode = 3", 4, "text"),
        ("[[step]]\nat = '5s'\ndo = 'kill'\nnode = 'node-1'\nhow = 'hard'", 5, "how"),
        ("[[step]]\nat = '5s'\ndo = 'partition'\ngroups = 'node-1,node-9 | node-2'", 1, "node-9"),
        ("[[step]]\nat = '5s'\ndo = 'link'\nlink = 'node-1 node-2'", 1, "link"),
        ("[[step]]\nat = '5s'\ndo = 'link'\nlink = 'node-1 -> node-2'\nloss = 'much'", 5, "loss"),
        ("[[step]]\nat = '5s'\ndo = 'link'\nlink = 'node-1 -> node-2'\nprofile = 'moon'", 5, "moon"),
        ("[[step]]\nat = '5s'\ndo = 'skew'\nnode = 'node-1'\noffset = 'late'", 5, "late"),
        ("[[step]]\nat = '5s'\ndo = 'disk'\nnode = 'node-1'\ndisk = 'floppy'", 5, "floppy"),
        ("[[step]]\nat = '5s'\ndo = 'disk'\nnode = 'node-1'\ndisk = 'ledger'\nfull = 'yes'", 6, "full"),
        ("[[step]]\nat = '5s'\ndo = 'byzantine'\nnode = 'node-1'\nbehaviour = 'rude'", 5, "rude"),
        ("[[step]]\nat = '5s'\ndo = 'byzantine'\nnode = 'node-1'\nbehaviour = 'garbage'\nseed = true", 6, "seed"),
        ("step = [{at = '5s', do = 'kill', node = 'node-1'}]", 1, "table of its own"),
        ("[[random]]\nfrom = '0'\nto = '5s'\nevery = '1s'\nlasting = '2s'\ndo = ['kill']", 1, "lasts"),
        ("[[random]]\nfrom = '0'\nto = '5s'\nevery = '1s'\nlasting = '1s'\ndo = ['dance']", 1, "do is a list"),
        ("[[random]]\nfrom = '0'\nto = '24h'\nevery = '1ms'\nlasting = '1ms'\ndo = ['kill']", 1, "more than"),
        ("[[random]]\nfrom = '0'\nto = '5s'\nevery = '1s'\nlasting = '1s'\ndo = ['kill']\nmuch = 1", 1, "much"),
    ],
)
def test_a_wrong_line_is_named_and_nothing_is_read(text: str, line: int, words: str) -> None:
    with pytest.raises(BlockRobotError) as refused:
        parse_plan("# a plan\n" + text, NAMES)
    assert refused.value.code == "FAULT_PLAN_INVALID"
    assert words in refused.value.detail
    if text:
        assert refused.value.detail.startswith(f"line {line + 1}:")
        assert refused.value.context["line"] == line + 1


def test_random_steps_come_from_the_seed_and_each_ends_again() -> None:
    text = RANDOM.format(seed=5, kinds=list(RANDOM_KINDS))
    plan = parse_plan(text, NAMES)
    assert plan == parse_plan(text, NAMES)
    assert plan != parse_plan(RANDOM.format(seed=6, kinds=list(RANDOM_KINDS)), NAMES)
    assert len(plan.steps) == 2 * 31
    begins, ends = plan.steps[::2], plan.steps[1::2]
    assert [step.at_ms for step in begins] == [2_000 * number for number in range(31)]
    assert [step.at_ms for step in ends] == [2_000 * number + 1_000 for number in range(31)]
    ending = {Kill: Restart, Pause: Resume, Partition: Partition, SetLink: SetLink, Skew: Skew, GoByzantine: Restart}
    for begin, end in zip(begins, ends, strict=True):
        assert type(end.action) is ending[type(begin.action)]  # type: ignore[index]
        if isinstance(begin.action, Kill | Pause | Skew | GoByzantine):
            assert end.action.node == begin.action.node  # type: ignore[union-attr]
    assert {type(step.action) for step in begins} == set(ending)


def test_one_node_alone_has_no_links_to_cut() -> None:
    with pytest.raises(BlockRobotError, match="one node"):
        parse_plan(RANDOM.format(seed=1, kinds=["partition"]), ("node-1",))
