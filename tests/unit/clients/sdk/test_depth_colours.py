"""The scale of distances: the nearer the brighter, and grey is nobody's distance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clients.sdk.pictures.depth_colours import (
    ANCHORS,
    FAR_MM,
    LEGEND_HEIGHT_PX,
    NEAR_MM,
    UNMEASURED_GREY,
    colour_pixels,
    draw_legend,
    scale_json,
)

_LUMA = np.array([0.0722, 0.7152, 0.2126])


def colour(mm: int) -> tuple[int, ...]:
    return tuple(int(part) for part in colour_pixels(np.full((1, 1), mm, np.uint16))[0, 0])


def test_the_ends_are_the_first_and_the_last_anchor() -> None:
    assert bytes(colour(NEAR_MM)[::-1]).hex() == bytes(colour(1)[::-1]).hex() == ANCHORS[0]
    assert bytes(colour(FAR_MM)[::-1]).hex() == bytes(colour(65_535)[::-1]).hex() == ANCHORS[-1]
    assert colour(0) == (UNMEASURED_GREY,) * 3


@given(st.integers(NEAR_MM, FAR_MM), st.integers(NEAR_MM, FAR_MM))
def test_what_is_nearer_is_never_darker(one_mm: int, other_mm: int) -> None:
    near, far = sorted((one_mm, other_mm))
    assert np.dot(colour(near), _LUMA) >= np.dot(colour(far), _LUMA) - 1.5
    assert len(set(colour(near))) > 1, "no distance is grey"


@pytest.mark.parametrize("width", [1, 64, 240, 480, 640, 4096])
def test_a_legend_is_as_wide_as_its_picture(width: int) -> None:
    legend = draw_legend(width)
    assert legend.shape == (LEGEND_HEIGHT_PX, width, 3)


def test_a_page_gets_the_same_scale() -> None:
    assert scale_json() == {
        "near_mm": NEAR_MM,
        "far_mm": FAR_MM,
        "anchors": list(ANCHORS),
        "unmeasured": UNMEASURED_GREY,
    }
