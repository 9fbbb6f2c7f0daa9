"""Scenario bags (rosbag2, MCAP, zstd), cached by content, with the tags in them: UIDs, of synthetic people only."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from clients.robot.sensing.message_names import (
    DEPTH_TOPIC,
    EMPTY_TOPIC,
    IMAGE_TYPE,
    ODOMETRY_TOPIC,
    ODOMETRY_TYPE,
    SIGHTING_TOPIC,
    SIGHTING_TYPE,
)
from clients.robot.sensing.sensor_events import NS_PER_MS, Odometry, Sighting
from clients.robot.synthetic.bag_messages import MessageCodec
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer
from clients.robot.synthetic.render import RENDERER_VERSION, Renderer
from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.tag_readings import readings
from clients.sdk.new_files import replace_file
from clients.sdk.terminal.processes import is_process_alive
from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError

BAG_VERSION = 1
RUN_START_MS = 1_579_278_405_650  # any instant will do: players move the timeline to the present
EMPTY_LEAD_MS = 10_000
BATCH_FRAMES_COUNT = 12
WORKERS_MAX_COUNT = 8
_UNFINISHED = re.compile(r"\..+-[0-9a-f]{24}\.([1-9][0-9]{0,9})\.[0-9a-f]{8}")
"""A bag that a process is making: `.NAME-KEY.PID.CHANCE`."""

Progress = Callable[[int, int], None]
Scene = Scenario | Drive
Rendered = list[tuple[int, bytes]]
_TAGS_FILE = "tags.json"
_UID_BYTES = 12  # an EPC-96


def frame_time_ms(scenario: Scenario, index: int) -> int:
    """On the bag's timeline."""
    return RUN_START_MS + round(index * 1000 / scenario.frame_rate)


def bag_key(scenario: Scenario, uids: Mapping[str, str]) -> str:
    """A hash of scenario, renderer, format and tags."""
    parts = [scenario.digest, str(RENDERER_VERSION), str(BAG_VERSION)]
    parts += [f"{alias}={uids[alias]}" for alias in scenario.tagged_aliases]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:24]


def make_bag(
    scene: Scene, uids: Mapping[str, str], cache: Path, *, progress: Progress | None = None, workers: int = 0
) -> Path:
    """Render it if not cached; a drive has odometry. `workers` 0: one per core; `progress` is per batch.

    Raises CONFIGURATION_INVALID.
    """
    scenario = scenario_of(scene)
    missing = [alias for alias in scenario.tagged_aliases if not uids.get(alias)]
    if missing:
        raise BlockRobotError("CONFIGURATION_INVALID", f"No tag is given for {', '.join(missing)}.")
    target = cache / f"{scenario.name}-{bag_key(scenario, uids)}"
    total = scenario.frame_count + scenario.empty_frames
    if (target / "metadata.yaml").is_file():
        if progress is not None:
            progress(total, total)
        return target
    cache.mkdir(parents=True, exist_ok=True)
    _remove_abandoned(cache)
    unfinished = cache / f".{target.name}.{os.getpid()}.{secrets.token_hex(4)}"
    unfinished.mkdir()
    try:
        _write(scene, uids, unfinished / target.name, progress or _silent, workers)  # which names its files so
        _settle(unfinished / target.name, target)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return target


def _remove_abandoned(cache: Path) -> None:
    """Unfinished bags of killed processes."""
    for path in cache.iterdir():
        found = _UNFINISHED.fullmatch(path.name)
        if found and not is_process_alive(int(found[1])) and path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)


def _silent(done: int, total: int) -> None: ...


def _settle(unfinished: Path, target: Path) -> None:
    if target.exists() and not (target / "metadata.yaml").is_file():
        shutil.rmtree(target)
    try:
        unfinished.rename(target)
    except OSError:
        if not (target / "metadata.yaml").is_file():
            raise


def scenario_of(scene: Scene) -> Scenario:
    return scene.scenario if isinstance(scene, Drive) else scene


def _write(scene: Scene, uids: Mapping[str, str], path: Path, progress: Progress, workers: int) -> None:
    scenario, codec = scenario_of(scene), MessageCodec()
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    writer.set_custom_data("blockrobot_scenario", scenario.name)
    total = scenario.frame_count + scenario.empty_frames
    done = 0
    with writer:
        depth = writer.add_connection(DEPTH_TOPIC, IMAGE_TYPE, typestore=codec.store)
        empty = writer.add_connection(EMPTY_TOPIC, IMAGE_TYPE, typestore=codec.store)
        tags = writer.add_connection(SIGHTING_TOPIC, SIGHTING_TYPE, typestore=codec.store)
        pending = [(at_ms, tags, data) for at_ms, data in _sightings(scene, uids, codec)]
        if isinstance(scene, Drive):
            places = writer.add_connection(ODOMETRY_TOPIC, ODOMETRY_TYPE, typestore=codec.store)
            pending += [(at_ms, places, bytes(codec.encode_odometry(found))) for at_ms, found in drive_odometry(scene)]
            pending.sort(key=lambda row: row[0])
        pending.reverse()
        for batch in _render_batches(scene, workers):
            for at_ms, data in batch:
                while pending and pending[-1][0] <= at_ms:
                    came_ms, connection, other = pending.pop()
                    _put(writer, connection, came_ms, other)
                _put(writer, empty if at_ms < RUN_START_MS else depth, at_ms, data)
            done += len(batch)
            progress(done, total)
        for came_ms, connection, other in reversed(pending):
            _put(writer, connection, came_ms, other)


def _put(writer: Writer, connection: Connection, at_ms: int, data: bytes) -> None:
    writer.write(connection, at_ms * NS_PER_MS, data)


def drive_odometry(drive: Drive, start_ms: int = RUN_START_MS) -> list[tuple[int, Odometry]]:
    """Return (arrival time, place) in arrival order, the drive beginning at `start_ms`."""
    found = []
    for sample in drive.odometry():
        at_ms = start_ms + round(1000 * sample.at_s)
        place = Odometry(at_ms, sample.z_m, -sample.x_m, -sample.yaw)
        found.append((start_ms + round(1000 * sample.arrives_s), place))
    return found


def scene_sightings(scene: Scene, uids: Mapping[str, str]) -> list[tuple[int, Sighting]]:
    """Return (arrival time, sighting) in arrival order, on the bag's timeline."""
    made = []
    for reading in scene.readings() if isinstance(scene, Drive) else readings(scene):
        at_ms = RUN_START_MS + round(reading.at_s * 1000)
        sighting = Sighting(
            first_seen_ms=at_ms,
            last_seen_ms=at_ms,
            uid=uids[reading.alias],
            antenna=reading.antenna,
            facing=reading.facing,
            rssi_dbm=reading.rssi_dbm,
            distance_m=reading.distance_m,
            sigma_m=reading.sigma_m,
        )
        made.append((RUN_START_MS + round(reading.arrives_s * 1000), sighting))
    return made


def _sightings(scene: Scene, uids: Mapping[str, str], codec: MessageCodec) -> Rendered:
    return [(at_ms, bytes(codec.encode_sighting(found, at_ms))) for at_ms, found in scene_sightings(scene, uids)]


def _render_batches(scene: Scene, workers: int) -> Iterator[Rendered]:
    """Encoded frames in time order, empty ones (negative indices) first."""
    scenario = scenario_of(scene)
    first = -scenario.empty_frames
    jobs = [
        range(start, min(start + BATCH_FRAMES_COUNT, scenario.frame_count))
        for start in range(first, scenario.frame_count, BATCH_FRAMES_COUNT)
    ]
    count = min(workers or os.cpu_count() or 1, WORKERS_MAX_COUNT, len(jobs))
    if count == 1 or multiprocessing.current_process().daemon:  # which may have no children: a cluster's worker
        worker = _Worker(scene)
        yield from (worker.render(job) for job in jobs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, mp_context=context, initializer=_start_worker, initargs=(scene,)) as pool:
        ahead = [pool.submit(_render_job, job) for job in jobs[: count * 2]]
        following = iter(jobs[count * 2 :])
        while ahead:
            yield ahead.pop(0).result()
            job = next(following, None)
            if job is not None:
                ahead.append(pool.submit(_render_job, job))


class _Worker:
    def __init__(self, scene: Scene) -> None:
        self._scenario = scenario_of(scene)
        self._renderer = DriveRenderer(scene) if isinstance(scene, Drive) else Renderer(scene)
        self._codec = MessageCodec()

    def render(self, job: range) -> Rendered:
        made = []
        for index in job:
            at_ms = frame_time_ms(self._scenario, index) - (EMPTY_LEAD_MS if index < 0 else 0)
            depth = self._renderer.frame(index) if index >= 0 else self._renderer.empty_frame(-index)
            made.append((at_ms, bytes(self._codec.encode_image(depth, at_ms))))
        return made


_workers: dict[str, _Worker] = {}


def _start_worker(scene: Scene) -> None:
    _workers["own"] = _Worker(scene)


def _render_job(job: range) -> Rendered:
    return _workers["own"].render(job)


def load_or_draw_tags(folder: Path, scenario: Scenario) -> dict[str, str]:
    """Alias -> UID (upper-case hex), in a file private to its user."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    path = folder / _TAGS_FILE
    known: dict[str, str] = read_json_text(path.read_text(encoding="utf-8")) if path.exists() else {}
    new = [alias for alias in scenario.tagged_aliases if alias not in known]
    if not new:
        return known
    drawn = {**known, **{alias: secrets.token_hex(_UID_BYTES).upper() for alias in new}}
    replace_file(path, json.dumps(drawn).encode())
    return drawn
