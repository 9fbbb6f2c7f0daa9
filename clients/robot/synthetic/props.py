"""Aids as capsules: wheelchair, rollator, stick, IV pole, bed, bag."""

from __future__ import annotations

import math

from clients.robot.synthetic.scenario import Bed, Person

Row = tuple[float, float, float, float, float, float, float]  # right, up, ahead of both ends, radius; metres

SEAT_M = 0.49
LYING_M = 0.74
WHEEL_SPOKES_COUNT = 10


def aid_rows(person: Person) -> list[Row]:
    if person.aid == "stick":
        return _stick(person)
    if person.aid == "iv-pole":
        return _iv_pole(person)
    if person.aid == "bag":
        return _bag(person)
    fixed = {"wheelchair": wheelchair_rows, "rollator": lambda: rollator_rows(person.height_m), "bed": empty_bed_rows}
    return fixed[person.aid]() if person.aid else []


def _stick(person: Person) -> list[Row]:
    h = person.height_m
    x = 0.185 * h * person.girth * person.shoulders
    return [(x, 0.48 * h, 0.13 * h, x + 0.03, 0.01, 0.17 * h, 0.014)]


def _bag(person: Person) -> list[Row]:
    h = person.height_m
    x = 0.13 * h * person.girth + 0.07
    return [(x, 0.52 * h, -0.06, x, 0.52 * h, 0.10, 0.11), (x, 0.42 * h, -0.06, x, 0.42 * h, 0.10, 0.11)]


def _wheel(x: float, centre_m: float, ahead: float, radius: float) -> list[Row]:
    rows: list[Row] = []
    for spoke in range(WHEEL_SPOKES_COUNT):
        a, b = (2 * math.pi * (spoke + step) / WHEEL_SPOKES_COUNT for step in (0, 1))
        up0, ahead0 = centre_m + radius * math.sin(a), ahead + radius * math.cos(a)
        up1, ahead1 = centre_m + radius * math.sin(b), ahead + radius * math.cos(b)
        rows.append((x, up0, ahead0, x, up1, ahead1, 0.018))
    return rows


def wheelchair_rows() -> list[Row]:
    rows: list[Row] = [(x, SEAT_M - 0.03, -0.20, x, SEAT_M - 0.03, 0.22, 0.04) for x in (-0.17, -0.06, 0.06, 0.17)]
    rows += [(x, SEAT_M, -0.22, x, 0.88, -0.27, 0.035) for x in (-0.18, -0.06, 0.06, 0.18)]
    for side in (-1.0, 1.0):
        x = 0.25 * side
        rows += _wheel(0.29 * side, 0.31, -0.08, 0.29)
        rows.append((0.29 * side, 0.31, -0.08, x, SEAT_M - 0.02, -0.08, 0.02))
        rows.append((x, 0.70, -0.20, x, 0.70, 0.14, 0.022))
        rows.append((x, SEAT_M - 0.03, 0.22, 0.8 * x, 0.10, 0.46, 0.018))
        rows.append((0.5 * x, 0.11, 0.42, x, 0.11, 0.52, 0.025))
        rows.append((x, 0.07, 0.20, x, 0.07, 0.22, 0.06))
        rows.append((0.8 * x, 0.90, -0.27, 0.8 * x, 0.94, -0.40, 0.018))
    return rows


def rollator_rows(height_m: float) -> list[Row]:
    grip = 0.53 * height_m
    rows: list[Row] = [(-0.2, 0.56, 0.42, 0.2, 0.56, 0.42, 0.05), (-0.2, 0.56, 0.52, 0.2, 0.56, 0.52, 0.05)]
    rows.append((-0.15, 0.42, 0.58, 0.15, 0.42, 0.58, 0.09))
    for side in (-1.0, 1.0):
        x = 0.27 * side
        rows.append((0.9 * x, grip, 0.24, 0.9 * x, grip, 0.40, 0.018))
        rows.append((0.9 * x, grip, 0.38, x, 0.10, 0.66, 0.016))
        rows.append((x, 0.55, 0.42, x, 0.10, 0.22, 0.016))
        rows.append((x, 0.09, 0.64, x, 0.09, 0.68, 0.07))
        rows.append((x, 0.09, 0.20, x, 0.09, 0.24, 0.07))
    return rows


def _iv_pole(person: Person) -> list[Row]:
    x = 0.145 * person.height_m * person.girth * person.shoulders + 0.05
    return iv_pole_rows(x, 0.27 * person.height_m)


def iv_pole_rows(x: float, z: float) -> list[Row]:
    rows: list[Row] = [(x, 0.08, z, x, 1.92, z, 0.014), (x - 0.14, 1.9, z, x + 0.14, 1.9, z, 0.01)]
    rows.append((x - 0.13, 1.62, z, x - 0.13, 1.80, z, 0.055))
    rows.append((x + 0.13, 1.66, z, x + 0.13, 1.80, z, 0.045))
    rows.append((x, 1.20, z + 0.03, x, 1.34, z + 0.03, 0.075))
    for leg in range(5):
        angle = 2 * math.pi * leg / 5
        rows.append((x, 0.10, z, x + 0.28 * math.cos(angle), 0.05, z + 0.28 * math.sin(angle), 0.018))
    return rows


def empty_bed_rows() -> list[Row]:
    rows: list[Row] = [(x, 0.60, -0.95, x, 0.60, 0.95, 0.075) for x in (-0.38, -0.25, -0.12, 0.0, 0.12, 0.25, 0.38)]
    for end, top in ((-1.02, 1.02), (1.02, 0.88)):
        rows += [(-0.42, up, end, 0.42, up, end, 0.035) for up in (0.58, 0.70, 0.82, top)]
        rows += [(x, 0.08, 0.92 * end, x, top, end, 0.025) for x in (-0.42, 0.42)]
    rows += [(x, 0.40, -0.9, x, 0.40, 0.9, 0.04) for x in (-0.36, 0.36)]
    rows.append((-0.30, 0.70, -0.80, 0.30, 0.70, -0.80, 0.09))
    return rows


def bed_rows(bed: Bed) -> list[Row]:
    """In corridor coordinates, foot end to the robot."""
    return [
        (bed.x_m + x0, u0, bed.z_m - a0, bed.x_m + x1, u1, bed.z_m - a1, radius)
        for x0, u0, a0, x1, u1, a1, radius in empty_bed_rows()
    ]
