"""Where there is room: keeps people, robot and furniture apart, by trying a bounded number of times."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from clients.robot.synthetic.driving.furniture import JUDGED_ONLY, KINDS, Piece, Shape, make_shape
from clients.robot.synthetic.driving.robot_motion import Track
from clients.robot.synthetic.driving.room import WALLS, Room
from clients.robot.synthetic.driving.solids import Floats
from clients.robot.synthetic.scenario import Person

SAMPLE_S = 0.1
ROBOT_M = 0.45  # from the robot's middle: nothing stands nearer
PERSON_M = 0.4
AID_M = {"wheelchair": 0.65, "rollator": 0.8, "iv-pole": 0.6, "bed": 1.2, "stick": 0.45, "bag": 0.45}
LYING_BOX = (0.0, 0.5, 0.0, 0.95, 1.0, 2.15, 0.0)
WALL_MAX_M = 0.9
APART = 0.6  # of what two people reach: arms and aids may pass
PIECE_TRIES_COUNT = 60
GAP_M = 0.03
BY_WALL_SHARE = 0.65
OUTLINE_M = 0.15
NEAREST_VIEW_M, FARTHEST_VIEW_M, VIEW_RAD = 1.2, 5.5, 0.5


def reach_of(person: Person) -> float:
    """Metres, with their aid."""
    return AID_M.get(person.aid, PERSON_M)


def lies(person: Person) -> bool:
    """Tell whether a person lies in a bed that nobody pushes."""
    return person.aid == "bed" and len({point[1:] for point in person.path}) == 1


def bed_of(person: Person) -> Piece:
    heading, _ = person.heading(person.path[0][0])
    return Piece("bed", Shape(boxes=(LYING_BOX,)), *person.path[0][1:], heading)


@dataclass(slots=True)
class Space:
    """A room with whom and what is in it already: places (n, 2: x, z) of the robot and of people by time."""

    room: Room
    times: Floats
    robot: Floats
    yaws: Floats
    people: list[tuple[Floats, float]] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)
    beds: list[Piece] = field(default_factory=list)  # what people lie in

    @classmethod
    def of(cls, room: Room, track: Track, duration_s: float) -> Space:
        times = np.arange(0.0, duration_s + 1e-9, SAMPLE_S)
        table = np.array(track)
        x, z, yaws = (np.interp(times, table[:, 0], table[:, column]) for column in (1, 2, 3))
        return cls(room, times, np.stack([x, z], axis=1), yaws)

    def draw_spot(self, rng: np.random.Generator) -> tuple[float, float]:
        """Return a place that the robot sees at some time, if nothing is in between; it may be outside the room."""
        moment = int(rng.integers(len(self.times)))
        away = float(rng.uniform(NEAREST_VIEW_M, FARTHEST_VIEW_M))
        towards = float(self.yaws[moment]) + float(rng.uniform(-VIEW_RAD, VIEW_RAD))
        x, z = self.robot[moment]
        return float(x) + away * math.sin(towards), float(z) + away * math.cos(towards)

    def path_of(self, person: Person) -> Floats:
        table = np.array(person.path)
        return np.stack([np.interp(self.times, table[:, 0], table[:, column]) for column in (1, 2)], axis=1)

    def admits(self, person: Person) -> bool:
        """Tell whether a person keeps clear of walls, of the robot, and of everybody, at any time."""
        path, reach = self.path_of(person), reach_of(person)
        if lies(person):
            bed = bed_of(person)
            clear = float(distances(bed, self.robot).min()) >= ROBOT_M and self._is_apart(bed, self.beds)
            clear = clear and self.room.inside(outline_of(bed), 0.0)
            return clear and all(float(distances(bed, other).min()) >= theirs for other, theirs in self.people)
        if not self.room.inside(path, min(reach, WALL_MAX_M)):
            return False
        if float(np.hypot(*(path - self.robot).T).min()) < reach + ROBOT_M:
            return False
        if any(float(distances(bed, path).min()) < reach for bed in self.beds):
            return False
        return all(
            float(np.hypot(*(path - other).T).min()) >= APART * (reach + theirs) for other, theirs in self.people
        )

    def add(self, person: Person) -> None:
        if lies(person):
            self.beds.append(bed_of(person))
        else:
            self.people.append((self.path_of(person), reach_of(person)))

    def add_furniture(self, rng: np.random.Generator, count: int, *, judging: bool) -> None:
        """Place so many pieces, or fewer if there is no room for more; in a judge's scene the first is of a judged kind."""
        known = [kind for kind in KINDS if kind not in JUDGED_ONLY]
        judged = [kind for kind in KINDS if kind in JUDGED_ONLY]
        for number in range(count):
            kinds = known if not judging else (judged if number == 0 else KINDS)
            for _ in range(PIECE_TRIES_COUNT):
                piece = self._draw_piece(rng, kinds[int(rng.integers(len(kinds)))])
                if self._is_free(piece):
                    self.pieces.append(piece)
                    break

    def _draw_piece(self, rng: np.random.Generator, kind: str) -> Piece:
        shape = make_shape(kind, rng)
        x, z = self.draw_spot(rng)
        heading = float(rng.uniform(-math.pi, math.pi))
        if rng.random() < BY_WALL_SHARE:
            wall = WALLS[int(rng.choice(4, p=(0.35, 0.35, 0.2, 0.1)))]
            heading = math.pi / 2 * float(rng.integers(4)) + float(rng.uniform(-0.25, 0.25))
            right, ahead = shape.half_size()
            cos, sin = abs(math.cos(heading)), abs(math.sin(heading))
            wide, deep = right * cos + ahead * sin, right * sin + ahead * cos
            along, inwards = (z, wide) if wall in ("left", "right") else (x, deep)
            rail = 0.07 if self.room.has_rails else 0.0
            x, z = self.room.place_by(wall, along, inwards + rail + float(rng.uniform(0.01, 0.1)))
        return Piece(kind, shape, x, z, heading)

    def _is_free(self, piece: Piece) -> bool:
        if not self.room.inside(outline_of(piece), 0.0):
            return False
        if float(distances(piece, self.robot).min()) < ROBOT_M:
            return False
        if any(float(distances(piece, path).min()) < reach for path, reach in self.people):
            return False
        return self._is_apart(piece, [*self.pieces, *self.beds])

    @staticmethod
    def _is_apart(piece: Piece, others: list[Piece]) -> bool:
        outline = outline_of(piece)
        return all(
            min(float(distances(other, outline).min()), float(distances(piece, outline_of(other)).min())) > GAP_M
            for other in others
        )


def distances(piece: Piece, points: Floats) -> Floats:
    """Return how far points (n, 2: x, z) are from the rectangle on which a piece stands."""
    right, ahead = piece.shape.half_size()
    cos, sin = math.cos(piece.heading), math.sin(piece.heading)
    dx, dz = points[:, 0] - piece.x, points[:, 1] - piece.z
    beside, before = np.abs(dx * cos + dz * sin) - right, np.abs(dx * sin - dz * cos) - ahead
    return np.asarray(np.hypot(np.maximum(beside, 0), np.maximum(before, 0)))


def outline_of(piece: Piece) -> Floats:
    """Return points (n, 2: x, z) along the rectangle on which a piece stands, and its middle."""
    right, ahead = piece.shape.half_size()
    count = max(2, round(2 * max(right, ahead) / OUTLINE_M))
    steps = np.linspace(-1, 1, count + 1)
    ones = np.ones(len(steps))
    local = np.concatenate(
        [np.stack(pair, axis=1) for pair in ((steps, ones), (steps, -ones), (ones, steps), (-ones, steps))]
        + [np.zeros((1, 2))]
    ) * (right, ahead)
    cos, sin = math.cos(piece.heading), math.sin(piece.heading)
    x, z = piece.x + local[:, 0] * cos + local[:, 1] * sin, piece.z + local[:, 0] * sin - local[:, 1] * cos
    return np.stack([x, z], axis=1)
