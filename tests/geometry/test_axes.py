from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from guidefield.geometry.directions import perpendicular_axes
from tests.kernels.evaluation import vectors


@given(vectors(1.0).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_axes_make_a_right_handed_frame(vector: np.ndarray) -> None:
    direction = vector / np.linalg.norm(vector)
    frame = np.vstack([perpendicular_axes(direction), direction])
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0)
