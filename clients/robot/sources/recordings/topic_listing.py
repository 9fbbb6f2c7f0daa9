"""List a recording's topics and guess which are depth, colour, tags, labels or sound."""

from __future__ import annotations

import textwrap
from collections import Counter
from dataclasses import dataclass
from typing import Any, Protocol

from clients.robot.sensing.message_names import ODOMETRY_TYPE, SIGHTING_TYPE
from clients.robot.sources.messages.decoding import IMAGE_TYPES, info_topic, read_focal_px
from clients.robot.sources.messages.field_map import json_paths
from clients.robot.sources.messages.image_decoding import (
    could_be_colour,
    could_be_depth,
    encoding_of,
)
from clients.robot.sources.messages.message_types import MessageTypes, own_types
from clients.robot.sources.messages.odometry_decoding import (
    ODOMETRY_TYPES,
    TRANSFORM_TYPES,
    TRANSFORMS_MAX_COUNT,
    frames_of,
)
from clients.robot.sources.messages.topics import STRING_TYPE, Topics, own_paths, shown_fields
from clients.robot.sources.recordings.recording import TopicFigures

LISTED_MAX_COUNT = 12
TF_SAMPLES_COUNT = 32
DRAFT_LINE_CHARS = 110
ROS_LOG_TYPES = ("rosgraph_msgs/msg/Log", "rcl_interfaces/msg/Log")
TAG_FIELDS = ("epc", "uid", "tag", "tag_id", "tagid", "ids", "tags", "rfid", "tid", "transponder")
TAG_NAMES = ("rfid", "tag", "epc", "uhf", "nfc")
LABEL_NAMES = ("emotion", "label", "mood", "affect", "state", "expression", "sentiment")
AUDIO_NAMES = ("audio", "sound", "mic", "speech", "voice", "wav")


class TopicSource(Protocol):
    """Messages by topic: a recording or a live sample."""

    topics: dict[str, TopicFigures]

    def types_of(self, type_name: str) -> MessageTypes:
        """Types among which messages of a type are explained."""

    def samples(self, topic: str, most: int = 1) -> list[Any]:
        """At most so many of a topic's first messages that can be decoded."""

    def explain_unknown(self, topic: str) -> str:
        """Why a topic's type is unknown, and what to do."""


@dataclass(frozen=True, slots=True)
class ListedTopic:
    """One topic: possible roles (`depth`, `rgb`, `tags`, `labels`, `audio`, `odometry`) and image encoding."""

    figures: TopicFigures
    could_be: tuple[str, ...]
    encoding: str

    @property
    def is_unexplained(self) -> bool:
        return not self.could_be and self.figures.type not in {*own_types().types, *ROS_LOG_TYPES}


def list_topics(recording: TopicSource) -> list[ListedTopic]:
    return [_listed(recording, figures) for _, figures in sorted(recording.topics.items())]


def describe(recording: TopicSource) -> str:
    listed = list_topics(recording)
    shown = [
        f"{item.figures.name} ({item.figures.type}"
        + (f", {item.encoding}" if item.encoding else "")
        + f", {item.figures.count} messages"
        + (f", could be {' or '.join(item.could_be)}" if item.could_be else "")
        + ")"
        for item in listed[:LISTED_MAX_COUNT]
    ]
    more = f" and {len(listed) - LISTED_MAX_COUNT} more" if len(listed) > LISTED_MAX_COUNT else ""
    return f"It has {'; '.join(shown) or 'no topic'}{more}."


def _listed(recording: TopicSource, figures: TopicFigures) -> ListedTopic:
    name, kind = figures.name.lower(), figures.type
    if kind in IMAGE_TYPES:
        first = _first(recording, figures.name)
        guesses = []
        if first is not None:
            guesses += ["depth"] if could_be_depth(first) else []
            guesses += ["rgb"] if could_be_colour(first) else []
        return ListedTopic(figures, tuple(guesses), "" if first is None else encoding_of(first))
    if kind == SIGHTING_TYPE:
        return ListedTopic(figures, ("tags",), "")
    if kind in ODOMETRY_TYPES:
        return ListedTopic(
            figures, ("odometry",) if kind == ODOMETRY_TYPE or _tf_frames(recording, figures) else (), ""
        )
    guesses = []
    if any(_last(path) in TAG_FIELDS for path in _known_json_paths(recording, figures)):
        return ListedTopic(figures, ("tags",), "")
    types = recording.types_of(kind)
    fields = {field.lower() for field in types.field_names(kind)} | {_last(path) for path in types.paths(kind)}
    words = kind.lower()
    if ((kind == STRING_TYPE or fields & set(TAG_FIELDS)) and _speaks(name + words, TAG_NAMES)) or fields & {
        "epc",
        "uid",
        "tagid",
        "tag_id",
    }:
        guesses.append("tags")
    if _speaks(name, LABEL_NAMES):
        guesses.append("labels")
    if _speaks(name + words, AUDIO_NAMES):
        guesses.append("audio")
    if kind == STRING_TYPE and not guesses:
        guesses = ["tags", "labels"]
    return ListedTopic(figures, tuple(guesses), "")


def _speaks(text: str, words: tuple[str, ...]) -> bool:
    return any(word in text for word in words)


def draft_topics(recording: TopicSource, listed: list[ListedTopic]) -> str:
    """Return a draft topics file, guessed by field names."""
    lines = ["# Drafted from what the recording looks like: check every line.", ""]
    depth = [item.figures.name for item in listed if "depth" in item.could_be]
    empty = [name for name in depth if "empty" in name.lower()]
    for name in [name for name in depth if name not in empty][:1]:
        lines += ["[depth]", f"topic = {_quoted(name)}", *_drafted_focal(recording, name), ""]
    for name in empty[:1]:
        lines += ["[empty]", f"topic = {_quoted(name)}", ""]
    for item in [item for item in listed if "tags" in item.could_be]:
        lines += ["[[tags]]", f"topic = {_quoted(item.figures.name)}", f"type = {_quoted(item.figures.type)}"]
        known = _known_json_paths(recording, item.figures)
        lines += [*_drafted_fields(known or _own_paths(recording, item.figures.type)), ""]
    for item in [item for item in listed if item.is_unexplained]:
        lines += [f"# {_on_one_line(line)}" for line in _drafted_guess(recording, item.figures)] + [""]
    lines += _drafted_odometry(recording, [item.figures for item in listed if "odometry" in item.could_be])
    for sense in ("rgb", "labels", "audio"):
        for item in [item for item in listed if sense in item.could_be][:1]:
            lines += [f"# [{sense}]", f"# topic = {_quoted(item.figures.name)}", ""]
    return "\n".join(lines)


def _drafted_odometry(recording: TopicSource, found: list[TopicFigures]) -> list[str]:
    """Odometry of its own before transforms."""
    if not found:
        return []
    figures = min(found, key=lambda one: one.type != ODOMETRY_TYPE)
    frames = _tf_frames(recording, figures)
    named = [f"parent = {_quoted(frames[0])}", f"child = {_quoted(frames[1])}"] if frames else []
    offset = "# camera_ahead_m = 0.0  # of the camera from the middle of the wheels; camera_left_m likewise"
    keep = "# keep = true  # on trial: keep people, without the room, also while the robot drives"
    return ["[odometry]", f"topic = {_quoted(figures.name)}", *named, offset, keep, ""]


def _tf_frames(recording: TopicSource, figures: TopicFigures) -> tuple[str, str] | None:
    """Return the frames of the first transform from odometry, None without one."""
    if figures.type not in TRANSFORM_TYPES:
        return None
    for message in recording.samples(figures.name, TF_SAMPLES_COUNT):  # several nodes may write there by turns
        for one in getattr(message, "transforms", ())[:TRANSFORMS_MAX_COUNT]:
            parent, child = frames_of(one)
            if "odom" in parent.lower():
                return parent, child
    return None


def _first(recording: TopicSource, topic: str) -> Any:
    return next(iter(recording.samples(topic)), None)


def _quoted(text: str) -> str:
    """Return a TOML string: names are a stranger's, and may hold anything."""
    escaped = (
        c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text.encode(errors="replace").decode()
    )
    return f'"{"".join(escaped)}"'


def _on_one_line(text: str) -> str:
    return "".join(" " if c.isspace() else c for c in text)


def _drafted_focal(recording: TopicSource, depth: str) -> list[str]:
    beside = info_topic(Topics(depth=depth))
    if beside in recording.topics and read_focal_px(_first(recording, beside)) is not None:
        return []
    return [
        "# focal_px = 525.0  # the camera's own, in pixels: no CameraInfo tells it, and 525 is assumed without this"
    ]


def next_steps(recording: TopicSource, listed: list[ListedTopic]) -> list[str]:
    """Such as the UID's field."""
    lines, is_found = [], False
    for item in [item for item in listed if "tags" in item.could_be and item.figures.type != STRING_TYPE]:
        if _guess_epc(recording, item.figures.type, sure=True):
            is_found = True
        else:
            lines.append(
                f"{item.figures.name} could be tags: write into epc in which field the tag's UID stands. "
                f"It has {_shown(recording, item.figures.type)}."
            )
    unexplained = [] if is_found else [item for item in listed if item.is_unexplained]
    return lines + [_unexplained_step(recording, item.figures) for item in unexplained[:LISTED_MAX_COUNT]]


def _unexplained_step(recording: TopicSource, figures: TopicFigures) -> str:
    if not recording.types_of(figures.type).knows(figures.type):
        return recording.explain_unknown(figures.name)
    guess = _guess_epc(recording, figures.type)
    return (
        f"{figures.name} carries {figures.type}, a type of your own. If it holds tag readings, write under [[tags]] in "
        f'the topics file: topic = "{figures.name}", and as epc the field where the tag\'s UID stands'
        + (f', perhaps epc = "{guess}"' if guess else "")
        + f". It has {_shown(recording, figures.type)}."
    )


def _drafted_guess(recording: TopicSource, figures: TopicFigures) -> list[str]:
    if not recording.types_of(figures.type).knows(figures.type):
        table = ["[[tags]]", f"topic = {_quoted(figures.name)}", f"type = {_quoted(figures.type)}", 'epc = ""']
        return [*textwrap.wrap(recording.explain_unknown(figures.name), DRAFT_LINE_CHARS), *table]
    fields = _drafted_fields(_own_paths(recording, figures.type), _guess_epc(recording, figures.type))
    return [
        f"{figures.name} carries {figures.type}, a type of your own. If it holds tag readings, take these marks away.",
        "[[tags]]",
        f"topic = {_quoted(figures.name)}",
        f"type = {_quoted(figures.type)}",
        *fields,
    ]


def _guess_epc(recording: TopicSource, type_name: str, *, sure: bool = False) -> str:
    paths = _of_one_list(_own_paths(recording, type_name))
    named = next((path for word in _FIELD_WORDS["epc"] for path in paths if _last(path) == word), "")
    if named or sure:
        return named
    return next((path for path in paths if recording.types_of(type_name).is_text(type_name, path)), "")


def _of_one_list(paths: list[str]) -> list[str]:
    """Return paths through the likeliest list, then unlisted ones. Parallel lists (`ids[]`, `dbs[]`) count as one."""
    counts: Counter[str] = Counter()
    for setting, words in _FIELD_WORDS.items():
        for path in paths:
            if "[]" in path and _last(path) in words:
                counts[_list_of(path)] += 2 if setting in _MEASURED else 1
    if not counts:
        return paths
    chosen = counts.most_common(1)[0][0]
    return [path for path in paths if _list_of(path) == chosen] + [path for path in paths if "[]" not in path]


def _list_of(path: str) -> str:
    return "[]" if path.endswith("[]") else path.partition("[]")[0]


def _own_paths(recording: TopicSource, type_name: str) -> list[str]:
    return own_paths(recording.types_of(type_name), type_name)


def _shown(recording: TopicSource, type_name: str) -> str:
    return shown_fields(recording.types_of(type_name), type_name)


def _known_json_paths(recording: TopicSource, figures: TopicFigures) -> list[str]:
    """Return JSON fields with known names only: other names may be UIDs."""
    if figures.type != STRING_TYPE:
        return []
    paths = json_paths(_first(recording, figures.name), "data")
    known = {word for words in _FIELD_WORDS.values() for word in words}
    return [path for path in paths if _last(path) in known]


def _drafted_fields(paths: list[str], epc: str = "") -> list[str]:
    found, usable = {}, _of_one_list(paths)
    for setting, words in _FIELD_WORDS.items():
        path = next((path for word in words for path in usable if _last(path) == word), None)
        if path is not None:
            found[setting] = path
    found = {"epc": found.get("epc", epc), **found}
    lines = [f'{setting} = "{path}"' for setting, path in found.items()]
    if found["epc"] == epc:
        lines[0] += "  # where the tag's UID stands"
    if "distance" in found and "distance_sigma" not in found:
        place = lines.index(f'distance = "{found["distance"]}"')
        lines[place] = f"# {lines[place]}  # only with distance_sigma, how far off it usually is, and distance_unit"
    elif "distance" in found:
        lines.append('distance_unit = "m"  # check it: m, cm or mm')
    if not found.keys() & {"antenna", "facing"}:
        lines.append(
            '# facing = "front"  # if the reader looks as the camera does; without it only people who walk are kept'
        )
    rest = [path for path in paths if path not in found.values()]
    return [*lines, *([f"# not named so far: {', '.join(rest)}"] if rest else [])]


def _last(path: str) -> str:
    return path.rpartition(".")[2].removesuffix("[]").lower()


_DISTANCE_WORDS = ("distance", "distance_m", "dist", "dist_m", "range", "range_m", "metres", "meters")
_MEASURED = ("rssi", "distance")
_FIELD_WORDS = {
    "epc": ("epc", "uid", "tag_id", "tagid", "rfid_tags_ids", "ids", "id", "tid", "data"),
    "antenna": ("antenna", "antenna_id", "antenna_name"),
    "facing": ("antenna_facing",),
    "rssi": ("rssi", "rssi_dbm", "rfid_tags_dbs", "dbs"),
    "distance": _DISTANCE_WORDS,
    "distance_sigma": ("distance_sigma",),
    "first_seen": ("first_seen",),
    "last_seen": ("last_seen",),
    "read_count": ("read_count",),
}
