"""Re-identification by silhouette and gait from what an attacker recovers over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.frame_redactor import KeptFrame
from clients.robot.sensing.sensor_events import Depth, Mask
from clients.robot.synthetic.camera import Labels
from clients.robot.synthetic.scenario import Person, published_run_1
from network.lab.hiding.attacks import BLUR, CONTROL, NONE, ON_OURS, OURS
from network.lab.hiding.features import Floats
from network.lab.hiding.hand_made import by_difference, largest
from network.lab.hiding.learned import LearnedAttacker, require_learning
from network.lab.hiding.run_scene import VISIBLE_MIN_PX, Stage, owner_cutout, placed, release
from network.lab.hiding.scenes import Scene, blur_others, show_owner_only

WALK_S = 6.0
FRAMES_A_SECOND = 6
PROBE_S = 12.0  # readings tell in some seconds whose silhouette it is; what was before is released with it
PROBES = ("apart", "crossing", "close")
GALLERY_WALKS = 6  # two of each
PROBE_WALKS = len(PROBES)
CLIP_FRAMES_COUNT = 12
PORTRAIT = (16, 24)  # width, height of a silhouette scaled to its own height
RECOVERED_MIN_PX = 150  # at half resolution; less is nothing
RECOVERED_SHARE = 0.5
EVERY_PX = 2


@dataclass(slots=True)
class GaitReport:
    """Right guesses (without silhouette: 1/people) and clips per way of hiding."""

    seed: int
    people: int
    right: dict[str, float] = field(default_factory=dict)
    clips: dict[str, int] = field(default_factory=dict)
    blind: dict[str, int] = field(default_factory=dict)
    frames: int = 0
    released: int = 0
    foreign_share: float = 0.0


@dataclass(frozen=True, slots=True)
class Clip:
    """A walk's silhouettes, and whose they are."""

    person: int
    masks: list[Mask]
    metres: list[float]  # height of each silhouette in metres, 0.0 where its distance is not known


def judge_gait(seed: int, people: int, attackers: Mapping[str, LearnedAttacker]) -> GaitReport:
    """One population, per way of hiding. Raises EXTRA_MISSING."""
    population = draw_population(seed, people)
    gallery = [clip for n in range(people) for walk in range(GALLERY_WALKS) for clip in _known(population, n, walk)]
    tell = learn_people(np.stack([describe(clip) for clip in gallery]), [clip.person for clip in gallery])
    report = GaitReport(seed, people)
    for number in range(people):
        for walk in range(GALLERY_WALKS, GALLERY_WALKS + PROBE_WALKS):
            for way, clips in _recovered(population, number, walk, attackers, report).items():
                for clip in clips:
                    report.clips[way] = report.clips.get(way, 0) + 1
                    if _is_blind(clip):
                        report.blind[way] = report.blind.get(way, 0) + 1
                        report.right[way] = report.right.get(way, 0.0) + 1 / people
                        continue
                    guess = int(tell(describe(clip)[None])[0])
                    report.right[way] = report.right.get(way, 0.0) + (guess == number)
    return report


def learn_people(table: Floats, people: Sequence[int]) -> Callable[[Floats], npt.NDArray[np.int64]]:
    """Return what tells by rows like these whose they are. Raises EXTRA_MISSING."""
    require_learning()
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis  # noqa: PLC0415 - the optional extra
    from sklearn.preprocessing import StandardScaler  # noqa: PLC0415 - the optional extra

    scaler, model = StandardScaler(), LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto")
    model.fit(scaler.fit_transform(table), people)
    return lambda rows: np.asarray(model.predict(scaler.transform(rows)), dtype=np.int64)


def draw_population(seed: int, people: int) -> list[Person]:
    rng = np.random.default_rng([seed, 0x6A17])
    return [build(rng) for _ in range(people)]


def build(rng: np.random.Generator) -> Person:
    return Person(
        alias="other",
        height_m=float(rng.uniform(1.5, 1.95)),
        girth=float(rng.uniform(0.8, 1.25)),
        cadence=float(rng.uniform(0.8, 1.2)),
        path=(),
        readings_s=(),
        also_every_s=0.0,
    )


def _scene(population: list[Person], number: int, walk: int) -> Scene:
    rng = np.random.default_rng([round(1e6 * population[0].height_m), number, walk])
    kind, length_s = PROBES[walk % len(PROBES)], WALK_S if walk < GALLERY_WALKS else PROBE_S
    stand = (float(rng.uniform(-0.9, -0.6)), float(rng.uniform(2.2, 3.2)))
    near, far = float(rng.uniform(2.0, 2.4)), float(rng.uniform(3.4, 3.9))
    x, away = float(rng.uniform(0.45, 0.75)), bool(rng.integers(2))
    path = []
    for i, at_s in enumerate(np.arange(0.0, length_s + 0.1, 1.5).tolist()):
        there = (i % 2) != away
        if kind == "crossing":  # past the owner's place and back, nearer or farther than the owner
            z = stand[1] + (1.0 if walk % 2 else -0.8)
            path.append((at_s, x if there else stand[0] - 0.5, max(1.6, z)))
        else:
            path.append((at_s, stand[0] + 0.6 if kind == "close" else x, far if there else near))
    other = replace(population[number], path=tuple(path))
    owner = Person(
        alias="owner",
        height_m=1.7,
        girth=1.0,
        cadence=1.0,
        path=((0.0, *stand), (length_s, stand[0] + 0.1, stand[1] + 0.2)),
        readings_s=(0.5, length_s - 0.1),
        also_every_s=0.2,
    )
    base = published_run_1()
    scenario = replace(
        base, name="gait", duration_s=length_s, seed=int(rng.integers(2**31)), people=(owner, other), digest=""
    )
    return Scene(number, walk, "gait", scenario)


def _indices(stage: Stage) -> range:
    return range(0, stage.scene.scenario.frame_count, stage.scene.scenario.frame_rate // FRAMES_A_SECOND)


def _clips(person: int, masks: list[Mask], metres: list[float]) -> list[Clip]:
    starts = range(0, len(masks) - CLIP_FRAMES_COUNT + 1, CLIP_FRAMES_COUNT)
    return [Clip(person, masks[s : s + CLIP_FRAMES_COUNT], metres[s : s + CLIP_FRAMES_COUNT]) for s in starts]


def _known(population: list[Person], number: int, walk: int) -> list[Clip]:
    stage = Stage(_scene(population, number, walk))
    masks, metres = [], []
    for index in _indices(stage):
        depth, labels = stage.renderer.frame_with_truth(index)
        mask = np.ascontiguousarray(labels[::2, ::2] == 2)
        masks.append(mask)
        metres.append(height_m(mask, depth[::2, ::2], stage.focal_px / 2))
    return _clips(number, masks, metres)


def _recovered(
    population: list[Person], number: int, walk: int, attackers: Mapping[str, LearnedAttacker], report: GaitReport
) -> dict[str, list[Clip]]:
    scene = _scene(population, number, walk)
    stage = Stage(scene)
    control = stage.control("owner")
    rng = np.random.default_rng([scene.scenario.seed, 0xC1])
    found: dict[str, tuple[list[Mask], list[float]]] = {way: ([], []) for way in (NONE, BLUR, OURS, CONTROL)}
    frames: dict[int, tuple[Depth, Labels]] = {}

    def see(index: int, depth: Depth, labels: Labels) -> None:
        frames[index] = depth, labels

    outputs = release(stage, _indices(stage), see)
    report.frames += len(frames)
    released = {output.sequence: output for output in outputs if isinstance(output, KeptFrame)}
    for index, (depth, labels) in frames.items():
        empty = stage.empty[int(rng.integers(len(stage.empty)))]
        owner = labels == 1
        pictures = {NONE: (depth, owner), BLUR: (blur_others(depth, labels > 1), owner)}
        if index in released:
            kept = placed(released[index], depth.shape)
            others_px = int(np.count_nonzero(labels > 1))
            report.released += 1
            if others_px >= VISIBLE_MIN_PX:
                shown = int(np.count_nonzero((labels > 1) & (kept > 0))) / others_px
                report.foreign_share = max(report.foreign_share, shown)
            pictures[OURS] = (show_owner_only(kept, empty), kept > 0)
            alone_kept = owner_cutout(stage, *control.frame_with_truth(index), 1, troubled=True)
            if alone_kept is not None:
                pictures[CONTROL] = (show_owner_only(alone_kept, empty), alone_kept > 0)
        for way, (picture, own) in pictures.items():
            view = stage.view(picture, own)
            plain = way in {NONE, BLUR}
            mask = largest(by_difference(view) if plain else attackers[ON_OURS].recover(view, every=EVERY_PX))
            found[way][0].append(mask)
            found[way][1].append(height_m(mask, view.picture, stage.focal_px / 2))
    return {way: _clips(number, masks, metres) for way, (masks, metres) in found.items()}


def height_m(mask: Mask, depth: np.ndarray[tuple[int, ...], np.dtype[np.uint16]], focal: float) -> float:
    rows = np.flatnonzero(mask.any(axis=1))
    measured = depth[mask & (depth > 0)]
    if rows.size == 0 or measured.size == 0:
        return 0.0
    return float((rows[-1] - rows[0] + 1) * np.median(measured) / 1000 / focal)


def _is_blind(clip: Clip) -> bool:
    seen = sum(int(np.count_nonzero(mask)) >= RECOVERED_MIN_PX for mask in clip.masks)
    return seen < RECOVERED_SHARE * len(clip.masks)


def describe(clip: Clip) -> Floats:
    portraits = np.stack([_portrait(mask) for mask in clip.masks])
    legs = portraits[:, -8:].sum(axis=(1, 2))
    rhythm = np.abs(np.fft.rfft(legs - legs.mean()))[1:6]
    widths = portraits.any(axis=1).sum(axis=1)
    known = [value for value in clip.metres if value > 0] or [0.0]
    numbers = [float(np.median(known)), float(widths.mean()), float(widths.std()), float(legs.std())]
    return np.concatenate(
        [portraits.mean(axis=0).ravel(), portraits.std(axis=0).ravel(), np.asarray(numbers), rhythm]
    ).astype(np.float32)


def _portrait(mask: Mask) -> Floats:
    """Centred, at fixed height: (24, 16), 0 to 1."""
    width, height = PORTRAIT
    empty = np.zeros((height, width), dtype=np.float32)
    if np.count_nonzero(mask) < RECOVERED_MIN_PX:
        return empty
    left, top, wide, tall = cv2.boundingRect(mask.astype(np.uint8))
    span = max(1, round(tall * width / height))
    canvas = np.zeros((tall, max(span, wide)), dtype=np.float32)
    start = (canvas.shape[1] - wide) // 2
    canvas[:, start : start + wide] = mask[top : top + tall, left : left + wide]
    return np.asarray(cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)
