"""Settings: a value takes effect with a majority, and none is taken that would stop the chain."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from consensus.chain.epoch_settings import ChainSettings, check_settings
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.state.settings import CUSTODY_COPIES, QUOTA, QUOTA_NAMES, UploadQuotas, read_copies, read_quotas
from tests.unit.contracts.system.consortium import Consortium, admin_of


def test_a_setting_takes_effect_with_the_second_of_three_voices(consortium: Consortium) -> None:
    proposed = consortium.must(admin_of("org-02"), "settings", "propose", "base_timeout_ms", 800)
    assert consortium.epoch.number == 0
    consortium.refused("APPROVED_ALREADY", admin_of("org-02"), "settings", "approve", proposed.txid)
    consortium.must(admin_of("org-03"), "settings", "approve", proposed.txid)
    assert consortium.epoch.settings == ChainSettings(base_timeout_ms=800)
    assert consortium.boundaries == [(consortium.height, consortium.epoch)]
    assert consortium.view("settings", "in_force")["base_timeout_ms"] == 800
    consortium.refused("PROPOSAL_CLOSED", admin_of("org-01"), "settings", "approve", proposed.txid)


def test_a_setting_that_is_unknown_or_in_force_already_makes_no_new_epoch(consortium: Consortium) -> None:
    consortium.agree_setting("production", "on-demand")
    assert consortium.boundaries == []
    consortium.refused("SETTING_UNKNOWN", admin_of("org-01"), "settings", "propose", "colour", 1)


def test_every_setting_of_a_chain_may_be_changed(consortium: Consortium) -> None:
    names = consortium.view("settings", "names")
    assert names == [*ChainSettings.__struct_fields__, "max_producers", *QUOTA_NAMES, CUSTODY_COPIES]
    values = [600, 9000, 20_000, 7, 4000, 3, "interval:250"]
    for name, value in zip(ChainSettings.__struct_fields__, values, strict=True):
        consortium.agree_setting(name, value)
    assert msgspec.structs.astuple(consortium.epoch.settings) == tuple(values)
    assert consortium.epoch.number == len(values)


def test_quotas_of_uploads_have_the_defaults_that_custodians_take_and_make_no_new_epoch(consortium: Consortium) -> None:
    in_force = consortium.view("settings", "in_force")
    assert {name: in_force[name] for name in QUOTA_NAMES} == msgspec.structs.asdict(UploadQuotas())
    for number, name in enumerate(QUOTA_NAMES):
        consortium.agree_setting(name, 7 + number)
        assert consortium.view("settings", "in_force")[name] == 7 + number
    assert consortium.boundaries == []
    read = {QUOTA.key(name): encode_value(7 + number) for number, name in enumerate(QUOTA_NAMES)}
    assert read_quotas(read.get) == UploadQuotas(*range(7, 7 + len(QUOTA_NAMES)))
    assert read_quotas({}.get) == UploadQuotas()


def test_how_many_custodians_keep_a_clip_is_decided_and_makes_no_new_epoch(consortium: Consortium) -> None:
    assert consortium.view("settings", "in_force")[CUSTODY_COPIES] == read_copies({}.get) == 0
    for copies in (2, 64, 0):
        consortium.agree_setting(CUSTODY_COPIES, copies)
        assert consortium.view("settings", "in_force")[CUSTODY_COPIES] == copies
        assert read_copies({QUOTA.key(CUSTODY_COPIES): encode_value(copies)}.get) == copies
    assert consortium.boundaries == []


WRONG: list[tuple[str, Any]] = [
    ("base_timeout_ms", 0),
    ("base_timeout_ms", 49),
    ("base_timeout_ms", 5),
    ("base_timeout_ms", 8001),
    ("base_timeout_ms", -1),
    ("base_timeout_ms", "500"),
    ("timeout_cap_ms", 499),
    ("timeout_cap_ms", 999),
    ("timeout_cap_ms", 60_001),
    ("heartbeat_ms", 0),
    ("heartbeat_ms", 1 << 200),
    ("min_block_interval_ms", -1),
    ("min_block_interval_ms", 500),
    ("max_clock_drift_ms", 0),
    ("max_clock_drift_ms", 499),
    ("max_clock_drift_ms", 60_001),
    ("blocks_per_turn", 0),
    ("blocks_per_turn", 101),
    ("max_producers", 0),
    ("max_producers", 22),
    ("max_producers", "4"),
    ("production", "manual"),
    ("production", 1),
    ("production", ""),
    ("production", "interval"),
    ("production", "interval:"),
    ("production", "interval:0"),
    ("production", "interval:-5"),
    ("production", "interval:60001"),
    ("production", "interval:3600000"),
    ("production", "interval:00000001"),
    ("production", "on-demand "),
    *((CUSTODY_COPIES, value) for value in (1, -1, 65, "2")),
    *((name, value) for name in QUOTA_NAMES for value in (0, -1, "512", (1 << 30) + 1)),
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_a_value_out_of_range_is_refused(consortium: Consortium, name: str, value: Any) -> None:
    consortium.refused("VALUE_WRONG", admin_of("org-01"), "settings", "propose", name, value)


def test_two_proposals_that_together_contradict_each_other_do_not_both_take_effect(consortium: Consortium) -> None:
    low = consortium.must(admin_of("org-01"), "settings", "propose", "timeout_cap_ms", 1000).txid
    high = consortium.must(admin_of("org-01"), "settings", "propose", "base_timeout_ms", 1200).txid
    consortium.must(admin_of("org-02"), "settings", "approve", low)
    consortium.refused("VALUE_WRONG", admin_of("org-02"), "settings", "approve", high)
    check_settings(consortium.epoch.settings)


def test_no_agreement_of_all_makes_every_round_end_before_its_votes_arrive(consortium: Consortium) -> None:
    """One millisecond for a round, and as much after a hundred lost ones: nothing would ever be final again."""
    for name in ("base_timeout_ms", "timeout_cap_ms"):
        consortium.refused("VALUE_WRONG", admin_of("org-01"), "settings", "propose", name, 1)
    consortium.agree_setting("base_timeout_ms", 50)
    consortium.agree_setting("timeout_cap_ms", 1000)
    consortium.refused("VALUE_WRONG", admin_of("org-01"), "settings", "propose", "min_block_interval_ms", 50)
    check_settings(consortium.epoch.settings)


def test_a_round_is_not_made_shorter_than_the_pause_between_two_blocks(consortium: Consortium) -> None:
    consortium.agree_setting("min_block_interval_ms", 200)
    consortium.refused("VALUE_WRONG", admin_of("org-01"), "settings", "propose", "base_timeout_ms", 200)
    consortium.agree_setting("base_timeout_ms", 201)


WRONG_IN_A_FILE_TOO = [
    (name, value)
    for name, value in WRONG
    if name not in ("max_producers", CUSTODY_COPIES, *QUOTA_NAMES)
    and value != "manual"
    and isinstance(value, str) == (name == "production")
]


@pytest.mark.parametrize(("name", "value"), WRONG_IN_A_FILE_TOO)
def test_a_genesis_file_may_say_nothing_that_the_contract_refuses(name: str, value: Any) -> None:
    with pytest.raises(BlockRobotError, match="GENESIS_INVALID"):
        check_settings(msgspec.structs.replace(ChainSettings(), **{name: value}))
