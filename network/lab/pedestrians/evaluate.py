"""`blockrobot bench pedestrians`: how many real pedestrians stay visible to whom."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import asdict

from clients.robot.hiding.frame_redactor import KeptFrame
from clients.robot.recording.occupancy import OccupancyMonitor
from clients.robot.recording.waiting_samples import cut_out_colour
from clients.robot.sensing.sensor_events import Mask
from consensus.errors import BlockRobotError
from network.bench.conditions import Result, measure_conditions
from network.lab.pedestrians.film import FILM, FRAME_MS, FRAME_RATE, Colour, Film, read_film
from network.lab.pedestrians.marks import Box, find_people, is_marked_film, marked_people
from network.lab.pedestrians.run_film import (
    READ_EVERY_FRAMES,
    SIGMA_M,
    Followed,
    Played,
    choose_bearers,
    follow_everybody,
    play,
    work_out_depths,
)

TAGS_DEFAULT_COUNT = 12
PICTURE_EACH_COUNT = 3


class Looked(Struct, frozen=True, kw_only=True):
    """What the marks say of the pictures of marked frames."""

    pictures_looked_at: int
    others_visible: int
    others_visible_without_hiding: int
    pictures_of_nobody_known: int


class Totals(Looked, frozen=True, kw_only=True):
    """What became of the pictures of all who bear tags."""

    people_shown: int
    pictures_kept: int
    pictures_withheld: int
    withheld_rate: float
    pictures_of_another: int
    frames_with_the_bearer_alone: int


class PedestrianFigures(Totals, frozen=True, kw_only=True):
    """How many real pedestrians stay visible to whom."""

    film_frames: int
    silhouettes: int
    silhouettes_taken_for_several_people: int
    people_followed: int
    tags_drawn: int
    pictures_kept_without_depth: int
    cpu_frame_ms: float


class Bearer(Struct, frozen=True, kw_only=True):
    """What became of one who bears a tag."""

    followed_frames: int
    first_frame: int
    last_frame: int
    pictures_kept: int
    pictures_withheld: dict[str, int]


class PedestrianResult(Result[PedestrianFigures], kw_only=True):
    """`people`: each tag's bearer by alias."""

    people: dict[str, Bearer]


def judge_pedestrians(
    seed: int = 1,
    *,
    tags: int = TAGS_DEFAULT_COUNT,
    frames: range | None = None,
    film_file: Path = FILM,
    picture: Path | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> PedestrianResult:
    """Return the measurement.

    `frames`: stretch of the film, else all. `picture`: PNG output. Other films are not compared with marks. Raises
    FILE_UNUSABLE.
    """
    if picture is not None and not picture.parent.is_dir():
        raise BlockRobotError("FILE_UNUSABLE", f"There is no folder {picture.parent} to write the picture into.")
    conditions = measure_conditions(
        nodes=0, seed=seed, tags_drawn=tags, readings_a_second=FRAME_RATE / READ_EVERY_FRAMES, sigma_m=SIGMA_M
    )
    on_progress("reading the film")
    film, first = _stretch(read_film(film_file), frames)
    started = time.process_time()
    on_progress("following everybody")
    depths = work_out_depths(film)
    seen = follow_everybody(film, depths)
    bearers = choose_bearers(seen, tags)
    on_progress("hiding")
    played = play(film, depths, bearers, seed)
    took_s = time.process_time() - started
    shown = _look(film, played, first, marked_people() if is_marked_film(film_file) else {})
    figures = PedestrianFigures(
        film_frames=len(film.frames),
        silhouettes=sum(seen.withhold_reasons.values()),
        silhouettes_taken_for_several_people=seen.withhold_reasons["merged"],
        people_followed=len(seen.followed),
        tags_drawn=len(bearers),
        pictures_kept_without_depth=keep_without_depth(film),
        **asdict(_totals(played, shown)),
        cpu_frame_ms=round(1000 * took_s / max(1, 2 * len(film.frames)), 1),
    )
    ok = figures.pictures_kept > 0 and not (
        figures.pictures_of_another
        or figures.pictures_kept_without_depth
        or figures.others_visible
        or figures.pictures_of_nobody_known
    )
    people = {alias: _person(played, one, alias, first) for alias, one in bearers.items()}
    if picture is not None:
        draw_shown(film, played, first, picture)
    return PedestrianResult(name="pedestrians", ok=ok, figures=figures, conditions=conditions, people=people)


def _stretch(film: Film, frames: range | None) -> tuple[Film, int]:
    if frames is None:
        return film, 0
    return Film(film.frames[frames.start : frames.stop], film.empty), frames.start


def _totals(played: Played, looked: Looked) -> Totals:
    kept = sum(map(len, played.kept.values()))
    withheld = sum(sum(reasons.values()) for reasons in played.withheld.values())
    whole = sum(played.whole.values())
    return Totals(
        **asdict(looked),
        people_shown=sum(1 for pictures in played.kept.values() if pictures),
        pictures_kept=kept,
        pictures_withheld=withheld,
        withheld_rate=round(withheld / max(1, kept + withheld), 3),
        pictures_of_another=sum(played.of_others.values()),
        frames_with_the_bearer_alone=whole,
    )


def _person(played: Played, one: Followed, alias: str, first: int) -> Bearer:
    return Bearer(
        followed_frames=len(one.ranges_m),
        first_frame=first + min(one.ranges_m),
        last_frame=first + max(one.ranges_m),
        pictures_kept=len(played.kept[alias]),
        pictures_withheld=dict(played.withheld[alias]),
    )


def keep_without_depth(film: Film) -> int:
    alone = OccupancyMonitor()
    kept = 0
    for index in range(len(film.frames)):
        at_ms = index * FRAME_MS
        judged = alone.find_occupancy(at_ms, at_ms, final=True)
        kept += bool(judged and judged.sole_owner) + bool(alone.silhouettes(at_ms, final=True))
    return kept


def _look(film: Film, played: Played, first: int, people: Mapping[int, tuple[Box, ...]]) -> Looked:
    looked = others = unknown = before = 0
    for pictures in played.kept.values():
        for kept in pictures:
            marked = people.get(first + kept.sequence)
            if marked is None:
                continue
            looked += 1
            found = find_people(_shown(film, kept), marked)
            others += len(found.others)
            unknown += found.owner is None
            before += len(marked) - 1
    return Looked(
        pictures_looked_at=looked,
        others_visible=others,
        others_visible_without_hiding=before,
        pictures_of_nobody_known=unknown,
    )


def _shown(film: Film, kept: KeptFrame) -> Mask:
    mask = np.zeros(film.shape, dtype=bool)
    alpha = cut_out_colour(film.frames[kept.sequence], kept.cutout)[..., 3] > 0
    mask[kept.cutout.y : kept.cutout.y + alpha.shape[0], kept.cutout.x : kept.cutout.x + alpha.shape[1]] = alpha
    return mask


def draw_shown(film: Film, played: Played, first: int, path: Path) -> None:
    """Draw each bearer's moments: camera's view above, rendition below. Raises OSError."""
    rows = []
    for alias, pictures in played.kept.items():
        if not pictures:
            continue
        step = max(1, len(pictures) // PICTURE_EACH_COUNT)
        chosen = pictures[step // 2 :: step][:PICTURE_EACH_COUNT]
        saw = [_titled(film.frames[kept.sequence], f"the camera, frame {first + kept.sequence}") for kept in chosen]
        gets = [_titled(_rendition(film, kept), f"{alias} gets") for kept in chosen]
        blank = [np.full_like(saw[0], 255)] * (PICTURE_EACH_COUNT - len(chosen))
        rows += [np.hstack([*saw, *blank]), np.hstack([*gets, *blank])]
    whole = np.vstack(rows) if rows else np.full((40, 640, 3), 255, np.uint8)
    done, data = cv2.imencode(".png", whole)
    assert done
    path.write_bytes(data.tobytes())


def _rendition(film: Film, kept: KeptFrame) -> Colour:
    picture = film.empty.copy()
    shown = _shown(film, kept)
    picture[shown] = film.frames[kept.sequence][shown]
    return picture


def _titled(frame: Colour, title: str) -> Colour:
    small = cv2.resize(frame, (frame.shape[1] // 2, frame.shape[0] // 2), interpolation=cv2.INTER_AREA)
    cv2.rectangle(small, (0, 0), (12 + 8 * len(title), 20), (255, 255, 255), -1)
    cv2.putText(small, title, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (20, 20, 20), 1, cv2.LINE_AA)
    return np.asarray(small, dtype=np.uint8)
