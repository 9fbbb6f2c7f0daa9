"""A scene in which the robot drives: its true way, people, furniture, surfaces, camera, and what it knows itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from clients.robot.synthetic.camera import CameraPose
from clients.robot.synthetic.driving.furniture import Piece
from clients.robot.synthetic.driving.odometry import Fault, OdometrySample, measure_odometry
from clients.robot.synthetic.driving.robot_motion import STEADY_MPS, STEADY_RADPS, Wobble
from clients.robot.synthetic.driving.room import Room
from clients.robot.synthetic.scenario import Person, Scenario, without
from clients.robot.synthetic.tag_readings import Reading, readings

SPEED_STEP_S = 0.02


@dataclass(frozen=True, slots=True)
class Mount:
    """How the camera is fixed (radians), how the body wobbles, and what the robot believes of height and pitch."""

    pitch: float
    roll: float
    wobble: Wobble
    believed_height_m: float
    believed_pitch: float


@dataclass(frozen=True, slots=True)
class Drive:
    """A drawn drive. `scenario` has the people, the reader, the picture's size, and as its camera's path the true way."""

    stratum: str
    judging: bool
    scenario: Scenario
    room: Room
    pieces: tuple[Piece, ...]
    mount: Mount
    time_of_flight: bool = False
    exposure_s: float = 0.0
    faults: tuple[Fault, ...] = ()

    @property
    def owners(self) -> dict[str, int]:
        """Return the label of each tagged person."""
        people = enumerate(self.scenario.people, start=1)
        return {person.alias: number for number, person in people if person.tagged}

    def camera_pose(self, at_s: float) -> CameraPose:
        x, z, yaw = self.scenario.camera_at(at_s)
        up, pitch, roll = self.room.ground.under_robot(z, yaw)
        speed, turn = self.speeds(at_s)
        driving = min(1.0, abs(speed) / STEADY_MPS + abs(turn) / STEADY_RADPS)
        nods, sways = self.mount.wobble.at(at_s, driving)
        height = up + self.scenario.camera_height_m
        return CameraPose(x, z, height, yaw, pitch + nods + self.mount.pitch, roll + sways + self.mount.roll)

    def speeds(self, at_s: float) -> tuple[float, float]:
        """Return (metres per second ahead, radians per second to the right)."""
        (x0, z0, yaw0), (x1, z1, yaw1) = (self.scenario.camera_at(at_s + step) for step in (0.0, SPEED_STEP_S))
        ahead = (x1 - x0) * math.sin(yaw0) + (z1 - z0) * math.cos(yaw0)
        return ahead / SPEED_STEP_S, (yaw1 - yaw0) / SPEED_STEP_S

    def odometry(self) -> tuple[OdometrySample, ...]:
        return measure_odometry(self.scenario.environment.camera_path, self.scenario.seed, self.faults)

    def readings(self) -> list[Reading]:
        return readings(self.scenario, self.seen_from_robot)

    def seen_from_robot(self, person: Person, at_s: float) -> tuple[float, float, float] | None:
        """Return a tag's (right, up, ahead) metres from the camera, level; None while absent."""
        place, seen = person.place(at_s), self.scenario.seen_from_robot(person, at_s)
        if place is None or seen is None:
            return None
        right, up, ahead = seen
        _, robot_z, _ = self.scenario.camera_at(at_s)
        return right, up + self.room.ground.up_m(place[1]) - self.room.ground.up_m(robot_z), ahead

    def without(self, *aliases: str) -> Drive:
        """All else unchanged."""
        return replace(self, scenario=without(self.scenario, *aliases))
