"""GDPR Article 12: in plain words, easily, without delay, for nothing, and with no more proof of who one is than needed.

(1) every code that a person meets has a sentence, and every right is one command of her wallet, with an example; (2)
nobody's leave is needed; (3) what she says holds from the next block; (5) it costs her nothing, however often; (6) the
key that the visit is hers by is all that she shows. That somebody explains it to her is a person's work: see
`docs/edpb-02-2025.md`.
"""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from clients.wallet.cli.main import wallet
from consensus.errors import CATALOGUE
from consensus.rights import right_codes
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from tests.unit.contracts.privacy.hospital import Hospital, Visit

RIGHTS = {
    "audit": 15, "records": 15, "view": 15, "correct": 16, "erase": 17, "restrict": 18, "lift": 18, "export": 20,
    "inbox": 19, "shares": 19, "object": 21, "wrong-person": 33, "consent": 7,
}  # fmt: skip


def test_1_every_code_that_a_person_meets_has_a_sentence() -> None:
    lists = (
        PURPOSES,
        SENSORS,
        right_codes.GROUNDS,
        right_codes.CORRECTIONS,
        right_codes.RISKS,
        right_codes.RECIPIENTS,
        right_codes.REASONS,
    )
    for codes in lists:
        assert codes
        for code, sentence in codes.items():
            assert sentence.endswith("."), code
            assert len(sentence.split()) >= 2, code


def test_1_every_refusal_says_what_to_do_next() -> None:
    for entry in CATALOGUE.values():
        assert len(entry.meaning.split()) >= 3, entry.code
        assert entry.next_step, entry.code


@pytest.mark.parametrize("command", RIGHTS)
def test_1_every_right_is_one_command_with_an_example(command: str) -> None:
    told = CliRunner().invoke(wallet, [command, "--help"])
    assert told.exit_code == 0
    assert f"blockrobot wallet {command}" in " ".join(told.output.split())


def _rights(hospital: Hospital, visit: Visit) -> list[tuple[str, str, list[object]]]:
    return [
        ("rights", "restrict", [visit.records, "accuracy"]),
        ("rights", "lift", [[]]),
        ("rights", "rectify", [visit.records, "metadata", bytes(32)]),
        ("rights", "object_to_release", [["research"]]),
        ("access", "request", [visit.records, "own-access"]),
        ("erasure", "request", [visit.records, []]),
    ]


def test_2_5_and_6_it_takes_her_key_and_nothing_else(hospital: Hospital, visit: Visit) -> None:
    """Nobody signs beside her, and nothing is paid: her key holds no coin, and the chain knows none."""
    assert hospital.view("identity", "member", visit.owner) is None, "not even who she is"
    for contract, entry, arguments in _rights(hospital, visit):
        hospital.must(visit.key, contract, entry, *arguments)


def test_5_asking_again_is_free_too(hospital: Hospital, visit: Visit) -> None:
    for _ in range(20):
        hospital.must(visit.key, "access", "request", visit.records, "own-access")


def test_3_what_she_says_holds_at_once(hospital: Hospital, visit: Visit) -> None:
    first = hospital.sign(visit.key, "rights", "restrict", [], "accuracy")
    then = hospital.sign(visit.key, "access", "request", [], "care")
    said, asked = hospital.block([first, then])
    assert (said.ok, asked.code) == (True, "RECORD_RESTRICTED"), "in the same block already"
