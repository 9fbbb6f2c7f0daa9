"""What generated classes of ROS 2 packages say about types, without ROS; and the feed where rclpy is not to be had."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from clients.robot.sources.live.ros2 import Ros2Feed
from clients.robot.sources.live.ros2_types import NESTED_MAX_COUNT, NotFoundError, RosType, load
from consensus.errors import BlockRobotError

FIELDS = {
    "flag": "boolean",
    "raw": "octet",
    "small": "int8",
    "level": "float",
    "matrix": "double[9]",
    "name": "string",
    "code": "string<24>",
    "names": "sequence<string>",
    "codes": "sequence<string<24>, 5>",
    "bytes": "sequence<uint8>",
    "few": "sequence<ward_msgs/Tag, 3>",
    "both": "ward_msgs/Tag[2]",
}
TEXT = [
    "bool flag",
    "byte raw",
    "int8 small",
    "float32 level",
    "float64[9] matrix",
    "string name",
    "string<=24 code",
    "string[] names",
    "string<=24[<=5] codes",
    "uint8[] bytes",
    "ward_msgs/Tag[<=3] few",
    "ward_msgs/Tag[2] both",
    "=" * 80,
    "MSG: ward_msgs/Tag",
    "string epc",
]


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """An empty package `ward_msgs`, importable as generated ones are."""
    module = ModuleType("ward_msgs.msg")
    monkeypatch.setitem(sys.modules, "ward_msgs", ModuleType("ward_msgs"))
    monkeypatch.setitem(sys.modules, "ward_msgs.msg", module)
    return module


def add_type(package: ModuleType, name: str, fields: dict[str, str], support: object = "loaded") -> None:
    """Add a class with what is read of generated ones."""

    class Generated:
        _TYPE_SUPPORT = support

        @staticmethod
        def get_fields_and_field_types() -> dict[str, str]:
            return fields

        @staticmethod
        def __import_type_support__() -> None:
            """Generated code swallows what goes wrong here."""

    setattr(package, name, Generated)


def test_a_definition_is_written_as_its_owner_would_and_means_the_same_to_the_decoder(package: ModuleType) -> None:
    add_type(package, "All", FIELDS)
    add_type(package, "Tag", {"epc": "string"})
    found = load("ward_msgs/msg/All")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(found.definition, "ward_msgs/msg/All"))

    assert found.definition.splitlines() == TEXT
    assert found.hash == store.hash_rihs01("ward_msgs/msg/All")
    assert [name for name, _ in store.fielddefs["ward_msgs/msg/All"][1]] == list(FIELDS)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "Tag",
        "ward_msgs/Tag",
        "ward_msgs/srv/Tag",
        "../msg/Tag",
        "os.path/msg/Tag",
        "ward_msgs/msg/__doc__",
        "É/msg/T",
    ],
)
def test_a_strange_name_of_a_type_leads_to_no_import(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.import_module", lambda wanted: pytest.fail(f"{wanted} was imported"))
    with pytest.raises(NotFoundError, match="no name of a message type"):
        load(name)


def test_a_package_or_a_type_that_is_not_there_is_said(package: ModuleType) -> None:
    for name in ("no_such_msgs/msg/Tag", "ward_msgs/msg/Tag"):
        with pytest.raises(NotFoundError, match="Python cannot import it"):
            load(name)


def test_a_package_whose_libraries_cannot_be_loaded_is_said(package: ModuleType) -> None:
    add_type(package, "Tag", {"epc": "string"}, support=None)
    with pytest.raises(NotFoundError, match="the libraries of ward_msgs cannot be loaded"):
        load("ward_msgs/msg/Tag")


def test_a_field_of_an_unknown_kind_and_a_type_without_end_are_refused(package: ModuleType) -> None:
    for kind in ("long double", "wstring", "sequence<wstring>"):
        add_type(package, "Odd", {"what": kind})
        with pytest.raises(NotFoundError, match="a kind that the robot does not read"):
            load("ward_msgs/msg/Odd")
    for number in range(NESTED_MAX_COUNT + 1):
        add_type(package, f"T{number}", {"next": f"ward_msgs/T{number + 1}"})
    with pytest.raises(NotFoundError, match="more than 256 types"):
        load("ward_msgs/msg/T0")


def test_only_a_hash_that_is_told_and_differs_is_of_another_type() -> None:
    known: Any = object()
    assert RosType(known, "", "RIHS01_aa").is_other({"RIHS01_aa", "RIHS01_bb"})
    assert not RosType(known, "", "RIHS01_aa").is_other({"RIHS01_aa"})
    assert not RosType(known, "", "RIHS01_aa").is_other(set())
    assert not RosType(known, "", "").is_other({"RIHS01_bb"})


def test_without_rclpy_it_says_what_to_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    feed = Ros2Feed()
    with pytest.raises(BlockRobotError, match=r"source /opt/ros/DISTRO/setup\.bash") as refused:
        feed.topics()
    feed.close()

    assert refused.value.code == "MIDDLEWARE_MISSING"
