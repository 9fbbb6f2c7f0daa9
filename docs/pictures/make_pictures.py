"""Makes docs/pictures/renditions.png: one frame of the synthetic corridor, as the camera and as each patient sees it.

It runs the robot's own redactor and the wallet's own composer over the published run. Must never draw or retouch a pixel.

Run it from the root of the repository: .venv/bin/python docs/pictures/make_pictures.py
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from clients.robot.hiding.background import empty_bank, learn_background
from clients.robot.hiding.frame_redactor import FrameRedactor, KeptFrame
from clients.robot.sensing.sensor_events import Depth, Frame, Sighting
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario, published_run_1
from clients.robot.synthetic.tag_readings import Reading, readings
from clients.sdk.pictures.rendition_picture import colourise, compose_on, decode_depth_png

OUT = Path(__file__).parent / "renditions.png"
SHOWN_FRAME = 279  # 9.3 s into the run: patient A, patient B and the visitor are all in the picture
EVERY_FRAMES_COUNT = 3
UNTIL_S = 14.0
EMPTY_FRAMES_COUNT = 12
PANEL_WIDTH_PX = 400
TITLE_HEIGHT_PX = 30
GAP_PX = 8
PNG_LEVEL = 9

Picture = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]


def sighting_of(reading: Reading) -> Sighting:
    """Return a synthetic reading as the robot's reader would report it."""
    at_ms = round(reading.at_s * 1000)
    return Sighting(
        at_ms, at_ms, "", reading.antenna, reading.facing, reading.rssi_dbm, reading.distance_m, reading.sigma_m
    )


def hide(scenario: Scenario, renderer: Renderer, empty: list[Depth]) -> tuple[Depth, dict[str, KeptFrame]]:
    """Play the run through the redactor; return the frame to show and what each owner keeps of it."""
    redactor, kept = FrameRedactor(learn_background(empty)), {}
    waiting = readings(scenario)
    outputs = []
    shown = renderer.frame(SHOWN_FRAME)
    for index in range(0, int(UNTIL_S * scenario.frame_rate), EVERY_FRAMES_COUNT):
        at_ms = round(index * 1000 / scenario.frame_rate)
        while waiting and waiting[0].at_s * 1000 <= at_ms:
            reading = waiting.pop(0)
            outputs += redactor.push_sighting(reading.alias, sighting_of(reading), known=True)
        outputs += redactor.push_frame(Frame(at_ms, index, shown if index == SHOWN_FRAME else renderer.frame(index)))
    for output in [*outputs, *redactor.flush()]:
        if isinstance(output, KeptFrame) and output.sequence == SHOWN_FRAME:
            kept[output.alias] = output
    return shown, kept


def panel(depth: Depth, title: str) -> Picture:
    """Return one titled picture in false colour, with the legend in metres."""
    image = np.asarray(cv2.imdecode(np.frombuffer(colourise(depth), np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)
    height = round(image.shape[0] * PANEL_WIDTH_PX / image.shape[1])
    small = np.asarray(cv2.resize(image, (PANEL_WIDTH_PX, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    strip = np.full((TITLE_HEIGHT_PX, PANEL_WIDTH_PX, 3), 255, dtype=np.uint8)
    cv2.putText(strip, title, (4, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.58, (30, 30, 30), 1, cv2.LINE_AA)
    return np.vstack([strip, small])


def main() -> None:
    """Write the picture."""
    scenario = published_run_1()
    renderer = Renderer(scenario)
    empty = [renderer.empty_frame(index) for index in range(EMPTY_FRAMES_COUNT)]
    shown, kept = hide(scenario, renderer, empty)
    room = decode_depth_png(empty_bank(empty)[0].png)
    panels = [panel(shown, "what the camera saw")]
    for alias, title in (("patient-a", "what patient A sees"), ("patient-b", "what patient B sees")):
        cutout = kept[alias].cutout
        panels.append(
            panel(compose_on(room, cutout.x, cutout.y, cutout.width, cutout.height, cutout.pixels_png), title)
        )
    gap = np.full((panels[0].shape[0], GAP_PX, 3), 255, dtype=np.uint8)
    whole = np.hstack([panels[0], gap, panels[1], gap, panels[2]])
    done, data = cv2.imencode(".png", whole, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    assert done
    OUT.write_bytes(data.tobytes())


if __name__ == "__main__":
    main()
