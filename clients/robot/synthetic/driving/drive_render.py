"""Renders drives: frames with the truth about people, aids, furniture and reflections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from clients.robot.sensing.sensor_events import Depth, Mask
from clients.robot.synthetic.body import Capsules, pose
from clients.robot.synthetic.camera import AID_BIT, Camera, CameraPose, Image, Labels, draw
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.room import Panel
from clients.robot.synthetic.driving.solids import Faces, draw_faces, joined_faces, reflected
from clients.robot.synthetic.environment import mirror, patches
from clients.robot.synthetic.noise import CameraNoise, FlightNoise, blur

HORIZON_M = 20.0
FURNITURE_BIT, REFLECTED_BIT = 0x40, 0x20  # next to AID_BIT in labels while they are drawn
NUMBER_BITS = 0x1F
EMPTY_NUMBERS = 1_000_000
CELL_M, PATTERN_CELLS = 0.015, 512  # of the blotches on a shiny surface, which repeat


@dataclass(frozen=True, slots=True, eq=False)
class DriveTruth:
    """A frame, the pose it was taken from, and for every pixel whom or what it shows (0: nobody, nothing).

    `labels`: the n-th person or their aid; `props`: the aid; `furniture`: the n-th piece; `reflections`: the n-th person
    in a mirror or in the floor.
    """

    depth: Depth
    labels: Labels
    props: Labels
    furniture: Labels
    reflections: Labels
    pose: CameraPose


class DriveRenderer:
    """Renders a drive's frames by index, byte-identical across processes."""

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        scenario = drive.scenario
        self.camera = Camera(scenario)
        self._noise = _noise_of(
            self.camera.shape, scenario.focal_px, scenario.seed, scenario.environment.holes, drive.time_of_flight
        )
        ground = drive.room.ground
        pieces = [(piece, ground.up_m(piece.z), FURNITURE_BIT | n) for n, piece in enumerate(drive.pieces, start=1)]
        self._faces = joined_faces([drive.room.faces(), *(piece.faces(up, label) for piece, up, label in pieces)])
        self._things = [(piece.capsules(up), label) for piece, up, label in pieces]

    def frame(self, index: int) -> Depth:
        """As uint16 millimetres."""
        return self.truth(index).depth

    def empty_frame(self, number: int) -> Depth:
        """From where the robot starts; each number has noise of its own."""
        return self._picture(0, [], number + EMPTY_NUMBERS).depth

    def truth(self, index: int) -> DriveTruth:
        return self._picture(index, self._bodies(index / self.drive.scenario.frame_rate), index)

    def _picture(self, index: int, bodies: list[tuple[Capsules, int]], noise: int) -> DriveTruth:
        drive, at_s = self.drive, index / self.drive.scenario.frame_rate
        at = drive.camera_pose(at_s)
        self.camera.move(at)
        depth, marks = self._draw(self._faces, self._things, bodies)
        for panel in drive.room.panels:
            self._show_panel(panel, at, depth, marks, bodies)
        share = drive.scenario.environment.mirror_floor
        if share > 0:
            shown = [(body, number | REFLECTED_BIT) for body, number in bodies]
            x, _, z = self._places(at, depth)
            mirror(self.camera, depth, marks, shown, *self._patches(x, z, share))
        _, turn = drive.speeds(at_s)
        passed_px = turn * drive.exposure_s * drive.scenario.focal_px
        depth, marks = blur(depth, marks, passed_px, drive.scenario.seed, noise)
        image, moved = self._noise.apply(depth, marks, noise)
        assert moved is not None
        return _truth_of(image, moved, at)

    def _bodies(self, at_s: float) -> list[tuple[Capsules, int]]:
        bodies = []
        for number, person in enumerate(self.drive.scenario.people, start=1):
            place, body = person.place(at_s), pose(person, at_s)
            if person.alias in self.drive.scenario.absent or place is None or body is None:
                continue
            up = np.array([0, self.drive.room.ground.up_m(place[1]), 0], dtype=np.float32)
            bodies.append((Capsules(body.start + up, body.end + up, body.radius, body.props), number))
        return bodies

    def _draw(
        self, faces: Faces, things: list[tuple[Capsules, int]], bodies: list[tuple[Capsules, int]]
    ) -> tuple[Image, Labels]:
        nearness = np.full(self.camera.shape, 1 / HORIZON_M, dtype=np.float32)
        marks = np.zeros(self.camera.shape, dtype=np.uint8)
        draw_faces(self.camera, nearness, marks, faces)
        depth = np.float32(1) / nearness
        for thing, label in things:
            draw(self.camera, depth, marks, thing, label)
        for body, label in bodies:
            draw(self.camera, depth, marks, body, label, label | AID_BIT)
        return depth, marks

    def _show_panel(
        self, panel: Panel, at: CameraPose, depth: Image, marks: Labels, bodies: list[tuple[Capsules, int]]
    ) -> None:
        face = self.drive.room.panel_face(panel)
        nearness = np.full(self.camera.shape, 1e-3, dtype=np.float32)
        draw_faces(self.camera, nearness, np.zeros_like(marks), face)
        surface = np.float32(1) / nearness
        region = surface < depth
        if not region.any():
            return
        x, up, z = self._places(at, surface)
        shown, lost = self._patches(x + z, up, panel.share)
        if panel.kind == "mirror":
            behind, whose = self._reflect(face, bodies)
            lost = lost | (behind < surface)
            depth[region], marks[region] = behind[region], whose[region]
        else:
            own = region & shown
            depth[own], marks[own] = surface[own], 0
        lost = lost & region
        depth[lost], marks[lost] = HORIZON_M, 0

    def _places(self, at: CameraPose, depth: Image) -> tuple[Image, Image, Image]:
        """Return where in the world (right, up, ahead) each pixel's surface is."""
        right, down, ahead = at.axes().astype(np.float32)
        eye = (at.x, at.height_m, at.z)
        x, up, z = (
            depth * (right[axis] * self.camera.ray_x + (down[axis] * self.camera.ray_y + ahead[axis]))
            + np.float32(eye[axis])
            for axis in range(3)
        )
        return x, up, z

    def _patches(self, first_m: Image, second_m: Image, share: float) -> tuple[Mask, Mask]:
        """Return blotches that are fixed to a surface with such coordinates."""
        first, second = (
            np.mod(part / np.float32(CELL_M), PATTERN_CELLS).astype(np.uint16) for part in (first_m, second_m)
        )
        shiny, dull = patches((PATTERN_CELLS + 1, PATTERN_CELLS + 1), share, self.drive.scenario.seed)
        return shiny[first, second], dull[first, second]

    def _reflect(self, face: Faces, bodies: list[tuple[Capsules, int]]) -> tuple[Image, Labels]:
        """Return what a mirror shows: all that is on its side, behind it."""
        at, other = face.corners[0, 0], face.corners[0, 1]
        normal = np.array([other[2] - at[2], 0.0, at[0] - other[0]])
        normal *= np.sign(normal @ (at - face.backs[0])) / np.linalg.norm(normal)

        def before(points: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
            return np.asarray((points - at) @ normal > 0)

        def turn(body: Capsules) -> Capsules:
            start, end = (reflected(ends.astype(np.float64), at, normal) for ends in (body.start, body.end))
            return Capsules(start.astype(np.float32), end.astype(np.float32), body.radius)

        kept = before(self._faces.corners).any(axis=1)
        faces = Faces(
            reflected(self._faces.corners[kept], at, normal),
            reflected(self._faces.backs[kept], at, normal),
            np.zeros(int(kept.sum()), dtype=np.uint8),
        )
        things = [(turn(thing), 0) for thing, _ in self._things]
        people = [(turn(body), number | REFLECTED_BIT) for body, number in bodies if before(body.start).all()]
        return self._draw(faces, [*things, *people], [])


def _truth_of(image: Depth, marks: Labels, at: CameraPose) -> DriveTruth:
    number = marks & np.uint8(NUMBER_BITS)
    none = np.uint8(0)
    kind = marks & np.uint8(FURNITURE_BIT | REFLECTED_BIT)
    labels = np.where(kind == 0, number, none)
    return DriveTruth(
        image,
        labels,
        np.where(marks >= AID_BIT, labels, none),
        np.where(kind == FURNITURE_BIT, number, none),
        np.where(kind == REFLECTED_BIT, number, none),
        at,
    )


@lru_cache(maxsize=4)
def _noise_of(shape: tuple[int, int], focal_px: float, seed: int, holes: float, time_of_flight: bool) -> CameraNoise:
    return (FlightNoise if time_of_flight else CameraNoise)(shape, focal_px, seed, holes)
