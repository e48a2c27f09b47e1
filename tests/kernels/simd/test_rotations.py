"""Angles and rotations of SIMD batches, against NumPy's functions and Pinocchio's exponential and logarithm."""

import numpy as np
import pinocchio as pin
import pytest
from numba import void

from guidefield.kernels.jit.arrays import FLOATS, FLOATS_OUT, MATRIX_OUT, VECTOR
from guidefield.kernels.jit.decorators import compiled, make_kernel as kernel
from guidefield.kernels.simd.rotations import (
    cosine_and_sine,
    quaternion_of_matrix,
    quaternion_of_vector,
    quaternion_product,
    vector_of_quaternion,
)
from guidefield.kernels.simd.vector import LANES, load, store


@compiled(void(VECTOR, MATRIX_OUT))
def _angles(angles, out):
    """Cosines and sines, shape (2, 8)."""
    c, s = cosine_and_sine(load(angles, 0))
    store(out[0], 0, c)
    store(out[1], 0, s)


@compiled(void(VECTOR, VECTOR, MATRIX_OUT))
def _turns(matrices, vectors, out):
    """Rotation vectors of matrices (9 * 8,), then of products of quaternions of vectors (6 * 8,)."""
    m = (
        load(matrices, 0), load(matrices, 8), load(matrices, 16), load(matrices, 24), load(matrices, 32),
        load(matrices, 40), load(matrices, 48), load(matrices, 56), load(matrices, 64),
    )  # fmt: skip
    q = quaternion_of_matrix(m)
    v = vector_of_quaternion(q[0], q[1], q[2], q[3])
    for k in range(5):
        store(out[k], 0, v[k])
    a = quaternion_of_vector(load(vectors, 0), load(vectors, 8), load(vectors, 16))
    b = quaternion_of_vector(load(vectors, 24), load(vectors, 32), load(vectors, 40))
    q = quaternion_product(a, b)
    v = vector_of_quaternion(q[0], q[1], q[2], q[3])
    for k in range(5):
        store(out[5 + k], 0, v[k])


@kernel(void(FLOATS, FLOATS_OUT))
def _single(numbers, out):
    """Cosines and sines of sixteen angles, then quaternions (4) of the vectors of these and what follows."""
    c, s = cosine_and_sine(load(numbers, 0))
    q = quaternion_of_vector(load(numbers, 0), load(numbers, LANES), load(numbers, 2 * LANES))
    store(out, 0, c)
    store(out, LANES, s)
    for k in range(4):
        store(out, (2 + k) * LANES, q[k])


@pytest.mark.parametrize("reach", [1.0, np.pi, 10.0, 1000.0])
def test_single_precision(reach):
    rng, out = np.random.default_rng(1), np.zeros((6, LANES), np.float32)
    for _ in range(200):
        vectors = rng.uniform(-reach, reach, (3, LANES)).astype(np.float32)
        _single(vectors.ravel(), out.reshape(-1))
        angles = vectors[0].astype(float)
        np.testing.assert_allclose(out[:2], [np.cos(angles), np.sin(angles)], rtol=0.0, atol=5e-7)
        if reach <= np.pi:  # a vector is up to a full turn long
            expected = [pin.Quaternion(pin.exp3(v)).coeffs() for v in vectors.T.astype(float)]
            signs = np.sign((out[2:].T * expected).sum(axis=1))
            np.testing.assert_allclose(out[2:] * signs, np.transpose(expected), rtol=0.0, atol=5e-7)


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 10.0, 1e5])
def test_cosines_and_sines(scale):
    rng = np.random.default_rng(0)
    quarters = 0.5 * np.pi * np.arange(-4, 4) * (scale >= 1.0)
    for angles in (scale * rng.uniform(-1.0, 1.0, 8), quarters, quarters + 1e-9):
        out = np.empty((2, 8))
        _angles(angles, out)
        np.testing.assert_allclose(out, [np.cos(angles), np.sin(angles)], rtol=0.0, atol=5e-16)


def _apart(a, b):
    """Angle between the rotations of two rotation vectors."""
    return np.linalg.norm(pin.log3(pin.exp3(a).T @ pin.exp3(b)))


@pytest.mark.parametrize("length", [0.0, 1e-10, 1e-4, 0.09, 0.11, 1.0, 2.5, 3.1, np.pi - 1e-7, np.pi])
def test_rotation_vectors(length):
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(8, 3))
    axes[:3] = np.eye(3)
    vectors = length * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    others = rng.normal(size=(8, 3))
    matrices = np.array([pin.exp3(v) for v in vectors])
    out = np.empty((10, 8))
    both = np.concatenate([vectors.T, others.T]).ravel()
    _turns(np.ascontiguousarray(matrices.reshape(8, 9).T).ravel(), both, out)
    for k in range(8):
        assert _apart(out[:3, k], vectors[k]) < 1e-14 + 1e-7 * (length > 3.1)  # near pi a matrix's trace is flat
        assert np.linalg.norm(out[:3, k]) <= np.pi + 1e-12
        assert out[3, k] == pytest.approx(length**2, abs=1e-15, rel=1e-7)
        # by their matrices: Pinocchio's logarithm loses digits within some milliradians of half a turn
        np.testing.assert_allclose(pin.exp3(out[5:8, k]), matrices[k] @ pin.exp3(others[k]), rtol=0.0, atol=1e-14)
        angle = np.linalg.norm(out[5:8, k])
        jacobian = pin.Jlog3(pin.exp3(out[5:8, k]))  # the inverse right Jacobian: 1 + [v]/2 + rate [v]^2
        v = pin.skew(out[5:8, k])
        np.testing.assert_allclose(np.eye(3) + 0.5 * v + out[9, k] * v @ v, jacobian, atol=1e-9 + 1e-8 * (angle > 3.0))
