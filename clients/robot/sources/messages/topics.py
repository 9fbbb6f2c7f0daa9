"""The topics file (TOML): which topic and message field holds what, checked against the recorded message types."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

from clients.robot.sensing.antenna_pairs import AntennaPair
from clients.robot.sensing.message_names import DEPTH_TOPIC, EMPTY_TOPIC, SIGHTING_TOPIC, SIGHTING_TYPE
from clients.robot.sensing.sensor_events import BEARING_SIGMA_MAX_DEG, DISTANCE_SIGMA_MAX_M
from clients.robot.sources.messages.field_map import (
    ANGLE_UNITS_DEG,
    LENGTH_UNITS_M,
    RSSI_UNITS_DBM,
    TIME_UNITS_NS,
    TagMap,
    check_path,
)
from clients.robot.sources.messages.message_types import MessageTypes
from clients.sdk.new_files import read_given_file
from consensus.bounded_text import TOML_MAX_BYTES, TextInvalidError, read_toml_text
from consensus.errors import BlockRobotError

TAG_TOPICS_MAX_COUNT = 16
LLRP_PORT = 5084
LLRP_READERS_MAX_COUNT = 8
ANTENNA_PAIRS_MAX_COUNT = 32
ANTENNA_MAX = 65_535
OFFSET_MAX_M = 5.0
ANTENNA_OFFSET_MAX_DB = 60.0

ClockName = Literal["stamp", "recording"]
DETECTION_MAP = TagMap(
    epc="epc",
    antenna="antenna",
    facing="antenna_facing",
    rssi="rssi",
    distance="distance",
    distance_sigma="distance_sigma",
    first_seen="first_seen",
    last_seen="last_seen",
    read_count="read_count",
)
STRING_TYPE = "std_msgs/msg/String"
_STRING_MAP = TagMap(epc="data")
_SETTINGS = (
    "clock", "depth", "empty", "tags", "rgb", "labels", "audio", "odometry", "definitions", "llrp", "antenna_pairs"
)  # fmt: skip
_HOST = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,252})|[0-9A-Fa-f:.]{2,45}")
FIELDS_SHOWN_MAX_COUNT = 24


@dataclass(frozen=True, slots=True)
class TagTopic:
    """A tag topic: field map and required message type (empty: any)."""

    topic: str
    map: TagMap
    type: str = ""


@dataclass(frozen=True, slots=True)
class LabelTopic:
    """A topic of estimates: paths of the text and optional confidence."""

    topic: str
    text: str = "data"
    confidence: str = ""


@dataclass(frozen=True, slots=True)
class AudioTopic:
    """A sound topic: path of 16-bit samples or WAV files, and their format."""

    topic: str
    data: str = "data"
    rate_hz: int = 16_000
    channels: int = 1


@dataclass(frozen=True, slots=True)
class OdometryTopic:
    """Where the robot says that it is: nav_msgs/Odometry, or from `parent` to `child` in tf messages.

    `camera_ahead_m`, `camera_left_m`: of the camera from what the odometry speaks of, mostly the middle of its wheels.
    `keep`: whether people are kept while the robot drives.
    """

    topic: str
    parent: str = ""
    child: str = ""
    camera_ahead_m: float = 0.0
    camera_left_m: float = 0.0
    keep: bool = False


@dataclass(frozen=True, slots=True)
class LlrpReader:
    """An LLRP reader; `front` antennas face the camera's way, `back` away."""

    host: str
    port: int = LLRP_PORT
    front: tuple[int, ...] = ()
    back: tuple[int, ...] = ()

    @property
    def address(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class Topics:
    """What to read. `clock` selects message or recording time; `focal_px` None: from the recording or unknown;
    `time_of_flight`: how the camera measures; `llrp` is live-only; `antenna_pairs` give readings their bearings.
    """

    depth: str = DEPTH_TOPIC
    focal_px: float | None = None
    time_of_flight: bool = False
    empty: str = EMPTY_TOPIC
    tags: tuple[TagTopic, ...] = (TagTopic(SIGHTING_TOPIC, DETECTION_MAP, SIGHTING_TYPE),)
    rgb: str = ""
    rgb_registered: bool = False
    labels: LabelTopic | None = None
    audio: AudioTopic | None = None
    odometry: OdometryTopic | None = None
    clock: ClockName = "stamp"
    definitions: Mapping[str, str] = field(default_factory=dict)
    llrp: tuple[LlrpReader, ...] = ()
    antenna_pairs: tuple[AntennaPair, ...] = ()

    @property
    def wanted(self) -> dict[str, str]:
        """Map each topic to its role: `depth`, `tags`, `rgb`, `labels`, `audio` or `odometry`."""
        wanted = {tags.topic: "tags" for tags in self.tags} | {self.depth: "depth"}
        if self.rgb:
            wanted[self.rgb] = "rgb"
        if self.labels is not None:
            wanted[self.labels.topic] = "labels"
        if self.audio is not None:
            wanted[self.audio.topic] = "audio"
        if self.odometry is not None:
            wanted[self.odometry.topic] = "odometry"
        return wanted


def load_topics(path: Path | None) -> Topics:
    """Raises TOPICS_INVALID, naming the setting."""
    if path is None:
        return Topics()
    try:
        data = read_given_file(path, TOML_MAX_BYTES)
    except FileNotFoundError:
        raise _wrong(f"There is no topics file at {path}.") from None
    except BlockRobotError as error:
        raise _wrong(error.detail) from None
    try:
        return parse_topics(data.decode("utf-8"))
    except UnicodeDecodeError:
        raise _wrong("The topics file is no text in UTF-8.") from None


def parse_topics(text: str) -> Topics:
    """Raises TOPICS_INVALID."""
    try:
        table = _Table(read_toml_text(text), "", _SETTINGS)
    except TextInvalidError as error:
        raise _wrong(f"The topics file is not valid TOML: {error}.") from error
    clock = table.word("clock", "stamp", get_args(ClockName))
    depth, empty = table.table("depth", "topic", "focal_px", "time_of_flight"), table.table("empty", "topic")
    rgb = table.table("rgb", "topic", "registered")
    labels, audio = table.table("labels", *_names_of(LabelTopic)), table.table("audio", *_names_of(AudioTopic))
    odometry = table.table("odometry", *_names_of(OdometryTopic))
    readers = tuple(_llrp_reader(row) for row in table.tables("llrp", *_names_of(LlrpReader)))
    topics = Topics(
        depth=(depth.text("topic", required=False) if depth else "") or DEPTH_TOPIC,
        focal_px=(depth.number("focal_px") or None) if depth else None,
        time_of_flight=depth.flag("time_of_flight") if depth else False,
        empty=empty.text("topic") if empty else EMPTY_TOPIC,
        # Who has a reader of their own, and names no topic of readings, has none.
        tags=tuple(_tag_topic(row) for row in table.tables("tags", "topic", "type", *_names_of(TagMap)))
        or (() if readers else Topics().tags),
        rgb=rgb.text("topic") if rgb else "",
        rgb_registered=rgb.flag("registered") if rgb else False,
        labels=_labels(labels) if labels else None,
        audio=_audio(audio) if audio else None,
        odometry=_odometry(odometry) if odometry else None,
        clock=cast(ClockName, clock),
        definitions=table.texts("definitions"),
        llrp=readers,
        antenna_pairs=tuple(_antenna_pair(row) for row in table.tables("antenna_pairs", *_names_of(AntennaPair))),
    )
    return check_topics(topics)


def check_topics(topics: Topics) -> Topics:
    """Raise TOPICS_INVALID if a topic has two roles."""
    if not topics.depth:
        raise _wrong("The topic of depth images has no name.")
    names = [topics.depth, *(tags.topic for tags in topics.tags), topics.rgb]
    names += [part.topic for part in (topics.labels, topics.audio, topics.odometry) if part is not None]
    named = [name for name in names if name]
    twice = {name for name in named if named.count(name) > 1}
    if twice:
        raise _wrong(f"The topic {sorted(twice)[0]} is named for two things.")
    if len(topics.tags) > TAG_TOPICS_MAX_COUNT:
        raise _wrong(f"There are more than {TAG_TOPICS_MAX_COUNT} topics of tags.")
    places = [(reader.host, reader.port) for reader in topics.llrp]
    if len(set(places)) < len(places) or len(places) > LLRP_READERS_MAX_COUNT:
        raise _wrong(f"An LLRP reader is named twice, or there are more than {LLRP_READERS_MAX_COUNT}.")
    _check_antenna_pairs(topics)
    return topics


def _check_antenna_pairs(topics: Topics) -> None:
    readers = [*(tags.topic for tags in topics.tags), *(reader.address for reader in topics.llrp)]
    if len(topics.antenna_pairs) > ANTENNA_PAIRS_MAX_COUNT:
        raise _wrong(f"There are more than {ANTENNA_PAIRS_MAX_COUNT} antenna_pairs.")
    for place, pair in enumerate(topics.antenna_pairs):
        if pair.reader and rooted(pair.reader) not in [*map(rooted, readers)]:
            raise _wrong(
                f"antenna_pairs[{place}].reader = {pair.reader!r} is none of the readers: {', '.join(readers)}."
            )
        tables = [tags for tags in topics.tags if rooted(tags.topic) == rooted(pair.reader or tags.topic)]
        if any(not (tags.map.antenna and tags.map.rssi) for tags in tables):
            raise _wrong(f"antenna_pairs[{place}] needs antenna and rssi in the [[tags]] table of its reader.")
        if not pair.reader and len(readers) > 1:
            raise _wrong(f"antenna_pairs[{place}].reader is missing: there are several, {', '.join(readers)}.")


def tags_by_type(topic: str, type_name: str) -> TagTopic:
    """Return the field map for RfidDetection or a string UID; else raises TOPICS_INVALID."""
    if type_name == SIGHTING_TYPE:
        return TagTopic(topic, DETECTION_MAP, SIGHTING_TYPE)
    if type_name == STRING_TYPE:
        return TagTopic(topic, _STRING_MAP, STRING_TYPE)
    raise _wrong(f"{topic} carries {type_name}: say in a topics file in which field the tag's UID stands.")


def with_topic(topics: Topics, **changes: Any) -> Topics:
    """Replace what is given; None keeps. Raises TOPICS_INVALID."""
    return check_topics(replace(topics, **{name: value for name, value in changes.items() if value is not None}))


def rooted(name: str) -> str:
    """With ROS's leading slash."""
    return f"/{name}" if name and not name.startswith(("/", "~")) else name


def with_rooted_names(topics: Topics) -> Topics:
    """Raises TOPICS_INVALID on duplicates."""
    return with_topic(
        topics,
        depth=rooted(topics.depth),
        rgb=rooted(topics.rgb),
        tags=tuple(replace(one, topic=rooted(one.topic)) for one in topics.tags),
        labels=topics.labels and replace(topics.labels, topic=rooted(topics.labels.topic)),
        audio=topics.audio and replace(topics.audio, topic=rooted(topics.audio.topic)),
        odometry=topics.odometry and replace(topics.odometry, topic=rooted(topics.odometry.topic)),
    )


def _tag_topic(table: _Table) -> TagTopic:
    if table.has("distance") and not table.has("distance_unit"):
        raise _wrong(f"{table.name}distance needs distance_unit: m, cm or mm, as the reader tells it.")
    sigma: str | float = table.number("distance_sigma") if table.is_number("distance_sigma") else ""
    sigma = sigma or table.path("distance_sigma")
    if table.has("bearing") and not (table.has("bearing_unit") and table.has("bearing_sigma")):
        raise _wrong(
            f"{table.name}bearing needs bearing_unit, deg or rad, and bearing_sigma, how far off it usually is."
        )
    bearing_sigma: str | float = table.number("bearing_sigma") if table.is_number("bearing_sigma") else ""
    made = TagMap(
        epc=table.path("epc", required=True),
        antenna=table.path("antenna"),
        facing=table.path("facing"),
        front=table.names("front"),
        back=table.names("back"),
        rssi=table.path("rssi"),
        rssi_unit=table.word("rssi_unit", "dBm", tuple(RSSI_UNITS_DBM)),
        distance=table.path("distance"),
        distance_sigma=sigma,
        distance_unit=table.word("distance_unit", "m", tuple(LENGTH_UNITS_M)),
        bearing=table.path("bearing"),
        bearing_sigma=bearing_sigma or table.path("bearing_sigma"),
        bearing_unit=table.word("bearing_unit", "deg", tuple(ANGLE_UNITS_DEG)),
        bearing_positive=table.word("bearing_positive", "left", ("left", "right")),
        first_seen=table.path("first_seen"),
        last_seen=table.path("last_seen"),
        time_unit=table.word("time_unit", "ns", tuple(TIME_UNITS_NS)),
        read_count=table.path("read_count"),
    )
    unit_m = LENGTH_UNITS_M[made.distance_unit]
    topic = TagTopic(table.text("topic"), made, table.text("type", required=False))
    if made.distance and made.distance_sigma == "":
        raise _wrong(f"{table.name}distance needs distance_sigma, a path or a number: how far off it usually is.")
    sigma_m = made.distance_sigma * unit_m if isinstance(made.distance_sigma, float) else 0.0
    if sigma_m > DISTANCE_SIGMA_MAX_M:
        raise _wrong(
            f"{table.name}distance_sigma is {sigma_m:g} m, and more than {DISTANCE_SIGMA_MAX_M:g} m is not taken: by such "
            "distances nobody is told from anybody else in a room. Check distance_unit; if the reader is that inaccurate, "
            "leave distance out, and nothing is kept by its readings."
        )
    if made.facing and (made.front or made.back):
        raise _wrong(f"{table.name}facing and the lists front and back are alternatives: keep one of them.")
    if (made.front or made.back) and not made.antenna:
        raise _wrong(f"{table.name}front and back name antennas: say in antenna where their number stands.")
    lists = {path.partition("[]")[0] for path in made.paths if "[]" in path}
    if len(lists) > 1 and not all(path.endswith("[]") for path in made.paths if "[]" in path):
        raise _wrong(f"{table.name}epc and its fellows go through different lists.")
    return topic


def _llrp_reader(table: _Table) -> LlrpReader:
    made = LlrpReader(
        host=table.text("host"),
        port=int(table.number("port", LLRP_PORT)),
        front=table.antennas("front"),
        back=table.antennas("back"),
    )
    if not _HOST.fullmatch(made.host) or made.port > 65_535:
        raise _wrong(f"{table.name}host and port are no address of a reader.")
    if set(made.front) & set(made.back):
        raise _wrong(f"{table.name}front and back name the same antenna.")
    return made


def _antenna_pair(table: _Table) -> AntennaPair:
    made = AntennaPair(
        left=table.antenna("left"),
        right=table.antenna("right"),
        offset_db=table.number_between("offset_db", -ANTENNA_OFFSET_MAX_DB, ANTENNA_OFFSET_MAX_DB),
        slope_db_per_deg=table.number("slope_db_per_deg"),
        sigma_db=table.number("sigma_db"),
        reader=table.text("reader", required=False),
    )
    if not made.is_usable():
        raise _wrong(
            f"{table.name[:-1]} tells no bearings: it needs two antennas, left and right, and sigma_db below "
            f"{BEARING_SIGMA_MAX_DEG:g} times slope_db_per_deg. Measure them by blockrobot robot antennas."
        )
    return made


def _labels(table: _Table) -> LabelTopic:
    return LabelTopic(table.text("topic"), table.path("text") or "data", table.path("confidence"))


def _audio(table: _Table) -> AudioTopic:
    made = AudioTopic(
        topic=table.text("topic"),
        data=table.path("data") or "data",
        rate_hz=int(table.number("rate_hz", 16_000)),
        channels=int(table.number("channels", 1)),
    )
    if not (4_000 <= made.rate_hz <= 192_000 and 1 <= made.channels <= 8):
        raise _wrong("audio.rate_hz must be between 4000 and 192000, audio.channels between 1 and 8.")
    return made


def _odometry(table: _Table) -> OdometryTopic:
    return OdometryTopic(
        topic=table.text("topic"),
        parent=table.text("parent", required=False),
        child=table.text("child", required=False),
        camera_ahead_m=table.number_between("camera_ahead_m", -OFFSET_MAX_M, OFFSET_MAX_M, "metres"),
        camera_left_m=table.number_between("camera_left_m", -OFFSET_MAX_M, OFFSET_MAX_M, "metres"),
        keep=table.flag("keep"),
    )


class _Table:
    """One table of the file. Unknown settings are refused first: a misspelt one looks as if another were missing."""

    def __init__(self, values: Mapping[str, Any], name: str, known: tuple[str, ...]) -> None:
        self._values = dict(values)
        self.name = f"{name}." if name else ""
        for key in sorted(values.keys() - set(known)):
            near = difflib.get_close_matches(key, known, 1)
            guess = f" Did you mean {near[0]}?" if near else ""
            raise _wrong(f"{self.name}{key} is no setting that the robot knows.{guess}")

    def _take(self, key: str, kind: type | tuple[type, ...], what: str) -> Any:
        value = self._values.pop(key, None)
        if value is not None and (not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool)):
            raise _wrong(f"{self.name}{key} must be {what}.")
        return value

    def text(self, key: str, *, required: bool = True) -> str:
        value = self._take(key, str, "a text")
        if required and not value:
            raise _wrong(f"{self.name}{key} is missing.")
        if value == "":
            raise _wrong(f"{self.name}{key} is empty: write what it is, or leave the line out.")
        return value or ""

    def path(self, key: str, *, required: bool = False) -> str:
        value = self.text(key, required=required)
        return check_path(value, f"{self.name}{key}") if value else ""

    def word(self, key: str, default: str, allowed: tuple[str, ...]) -> str:
        value = self.text(key, required=False) or default
        if value not in allowed:
            raise _wrong(f"{self.name}{key} = {value!r} is none of {', '.join(allowed)}.")
        return value

    def flag(self, key: str) -> bool:
        return bool(self._take(key, bool, "true or false"))

    def has(self, key: str) -> bool:
        return key in self._values

    def is_number(self, key: str) -> bool:
        return isinstance(self._values.get(key), int | float)

    def number(self, key: str, default: float = 0.0) -> float:
        value = self._take(key, (int, float), "a number")
        if value is not None and not 0 < value < 1e9:
            raise _wrong(f"{self.name}{key} must be above 0.")
        return default if value is None else float(value)

    def number_between(self, key: str, least: float, most: float, unit: str = "") -> float:
        value = self._take(key, (int, float), f"a number{' of ' if unit else ''}{unit}")
        if value is not None and not least <= value <= most:
            raise _wrong(f"{self.name}{key} must be between {least:g} and {most:g}{' ' if unit else ''}{unit}.")
        return float(value or 0.0)

    def antenna(self, key: str) -> int:
        value = self._take(key, int, "an antenna's number, from 1")
        if value is None or not 0 < value <= ANTENNA_MAX:
            raise _wrong(f"{self.name}{key} must be an antenna's number, from 1.")
        return int(value)

    def names(self, key: str) -> tuple[str, ...]:
        values = self._take(key, list, "a list of antennas") or []
        if not all(isinstance(value, str | int) for value in values):
            raise _wrong(f"{self.name}{key} must be a list of numbers or names.")
        return tuple(str(value) for value in values)

    def antennas(self, key: str) -> tuple[int, ...]:
        values = self._take(key, list, "a list of antennas, by number") or []
        if not all(type(value) is int and 0 < value <= ANTENNA_MAX for value in values):
            raise _wrong(f"{self.name}{key} must be a list of antennas' numbers, from 1.")
        return tuple(values)

    def texts(self, key: str) -> dict[str, str]:
        values = self._take(key, dict, "a table of texts") or {}
        if not all(isinstance(value, str) for value in values.values()):
            raise _wrong(f"{self.name}{key} must hold texts.")
        return {str(name): value for name, value in values.items()}

    def table(self, key: str, *known: str) -> _Table | None:
        value = self._take(key, dict, "a table")
        return None if value is None else _Table(value, f"{self.name}{key}", known)

    def tables(self, key: str, *known: str) -> list[_Table]:
        values = self._take(key, list, f"a list of tables, [[{key}]]") or []
        if not all(isinstance(value, dict) for value in values):
            raise _wrong(f"{self.name}{key} must be a list of tables, [[{key}]].")
        return [_Table(value, f"{key}[{place}]", known) for place, value in enumerate(values)]


def _names_of(
    kind: type[TagMap | LabelTopic | AudioTopic | OdometryTopic | LlrpReader | AntennaPair],
) -> tuple[str, ...]:
    return tuple(one.name for one in fields(kind))


def _wrong(detail: str) -> BlockRobotError:
    return BlockRobotError("TOPICS_INVALID", detail)


def missing_field(topics: Topics, topic: str, type_name: str, types: MessageTypes) -> str:
    """Return the setting with a missing field, as a sentence, or empty."""
    for key, path in _named(topics, topic):
        if not types.has_path(type_name, path):
            words = ', and it is neither "front" nor "back"' if key.endswith(".facing") else ""
            return f'{key} = "{path}" is no field of {type_name}{words}. It has {shown_fields(types, type_name)}.'
    return ""


def shown_fields(types: MessageTypes, type_name: str) -> str:
    paths = own_paths(types, type_name)
    more = f" and {len(paths) - FIELDS_SHOWN_MAX_COUNT} more" if len(paths) > FIELDS_SHOWN_MAX_COUNT else ""
    return ", ".join(paths[:FIELDS_SHOWN_MAX_COUNT]) + more


def own_paths(types: MessageTypes, type_name: str) -> list[str]:
    return [path for path in types.paths(type_name) if not path.startswith("header.")]


def _named(topics: Topics, topic: str) -> Iterator[tuple[str, str]]:
    for place, tags in enumerate(topics.tags):
        if tags.topic == topic:
            yield from ((f"tags[{place}].{key}", path) for key, path in tags.map.named_paths.items())
    if topics.labels is not None and topics.labels.topic == topic:
        yield "labels.text", topics.labels.text
        if topics.labels.confidence:
            yield "labels.confidence", topics.labels.confidence
    if topics.audio is not None and topics.audio.topic == topic:
        yield "audio.data", topics.audio.data
