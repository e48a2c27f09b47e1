"""Pieces of a surface: which vertices are connected, each piece by its lowest vertex."""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import INDEX_MATRIX, INDICES_OUT, Integers, compiled, inlined


@inlined
def _root(labels: Integers, vertex: int) -> int:
    """The lowest vertex that a vertex is known to be connected with; ways there are halved (R. Tarjan)."""
    while labels[vertex] != vertex:
        labels[vertex] = labels[labels[vertex]]
        vertex = labels[vertex]
    return vertex


@compiled(void(INDEX_MATRIX, INDICES_OUT))
def lowest_connected(simplices: Integers, labels_out: Integers) -> None:
    """Write for each vertex the lowest one that edges or triangles connect it to.

    Args:
        simplices: Vertices of each edge or triangle, shape (n, k).
        labels_out: Shape (count,).
    """
    for vertex in range(labels_out.shape[0]):
        labels_out[vertex] = vertex
    for i in range(simplices.shape[0]):
        a = _root(labels_out, simplices[i, 0])
        for corner in range(1, simplices.shape[1]):
            b = _root(labels_out, simplices[i, corner])
            low, high = min(a, b), max(a, b)
            labels_out[high] = low
            a = low
    for vertex in range(labels_out.shape[0]):  # a label is never above its vertex, so that those before are final
        labels_out[vertex] = labels_out[labels_out[vertex]]
